"""Fine-tuning: it learns, it resumes to the bit, and it says what went wrong."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.site_dataset import TinySite, tiny_site
from wibam_core.config import FinetuneConfig
from wibam_core.errors import NoMultiViewVehicles, NonFiniteLoss, TooFewInstants
from wibam_core.models.trunk import TrunkShape
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.networks.small.network import SmallMonocular
from wibam_core.progress import silent
from wibam_core.training.dataset import site_views
from wibam_core.training.finetune import FinetuneResult, SiteDataset, finetune
from wibam_core.training.views import LabelledView

TINY = TrunkShape(channels=(8, 8, 16, 16, 16), blocks=(0, 0, 0, 0), neck=8)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> TinySite:
    return tiny_site(tmp_path_factory.mktemp("site"))


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def dataset_of(site: TinySite) -> SiteDataset:
    views = site_views(site.instants, site.frames, site.lifts, site.rig)
    return SiteDataset(site.frames, site.rig, views[:9], views[9:])


def network() -> SmallMonocular:
    torch.manual_seed(0)
    return SmallMonocular(SmallNetwork(TINY))


def options(**values: object) -> FinetuneConfig:
    return FinetuneConfig.model_validate(
        {"steps": 6, "steps_per_epoch": 2, "batch_size": 3, "crop_share": 0.4, **values}
    )


def assert_equal(one: FinetuneResult, two: FinetuneResult) -> None:
    for (name, a), (_, b) in zip(*(run.network.module.state_dict().items() for run in (one, two)), strict=True):
        assert torch.equal(a, b), name
    assert one.epochs == two.epochs
    assert one.kept_step == two.kept_step


@pytest.mark.parametrize("method", ["lifted", "paper", "combined"])
def test_resumes_equal_to_the_bit(site: TinySite, tmp_path: Path, method: str) -> None:
    config = options(method=method)
    whole = finetune(network(), dataset_of(site), config, silent, tmp_path / "whole")

    def stop_in_the_second_epoch(fraction: float, message: str = "", **figures: float) -> None:
        if fraction >= 0.5:
            raise InterruptedError("stop")

    with pytest.raises(InterruptedError):
        finetune(network(), dataset_of(site), config, stop_in_the_second_epoch, tmp_path / "cut")
    resumed = finetune(network(), dataset_of(site), config, silent, tmp_path / "cut")
    assert_equal(whole, resumed)


def test_the_seed_decides(site: TinySite, tmp_path: Path) -> None:
    runs = [
        finetune(network(), dataset_of(site), options(steps=2, seed=seed), silent, tmp_path / str(place))
        for place, seed in enumerate((1, 1, 2))
    ]
    assert_equal(runs[0], runs[1])
    assert runs[0].epochs[0].train != runs[2].epochs[0].train


@pytest.mark.parametrize(
    "chosen",
    [
        {"method": "lifted"},
        {"method": "paper"},
        {"method": "paper", "own_view": True, "box_heads": True},
        {"method": "combined", "own_view": True},
    ],
)
def test_the_loss_falls(site: TinySite, tmp_path: Path, chosen: dict[str, object]) -> None:
    config = options(steps=80, steps_per_epoch=10, learning_rate=1e-3, **chosen)  # higher ones may diverge
    reports: list[float] = []
    result = finetune(network(), dataset_of(site), config, lambda f, m="", **k: reports.append(f), tmp_path)
    totals = [epoch.train["total"] for epoch in result.epochs]
    assert totals[-1] < 0.8 * totals[0]
    assert result.epochs[-1].validation["total"] < result.epochs[0].validation["total"]
    assert reports[-1] == 1.0
    assert reports == sorted(reports)
    assert not result.network.module.training


def test_a_checkpoint_of_other_options_or_a_damaged_one_is_not_used(site: TinySite, tmp_path: Path) -> None:
    finetune(network(), dataset_of(site), options(steps=2), silent, tmp_path)
    other = finetune(network(), dataset_of(site), options(steps=4), silent, tmp_path)
    assert len(other.epochs) == 2
    (tmp_path / "checkpoint.pt").write_bytes(b"not a checkpoint")
    assert len(finetune(network(), dataset_of(site), options(steps=2), silent, tmp_path).epochs) == 1


@pytest.mark.parametrize("method", ["lifted", "paper", "combined"])
def test_a_loss_that_is_not_finite_names_the_frames(site: TinySite, tmp_path: Path, method: str) -> None:
    poisoned = network()
    poisoned.module.heads["size"].get_parameter("bias").data.fill_(float("nan"))
    with pytest.raises(NonFiniteLoss) as caught:
        finetune(poisoned, dataset_of(site), options(method=method), silent, tmp_path)
    assert caught.value.details["step"] == 0
    assert len(caught.value.details["frames"]) == 3
    assert any(camera in caught.value.message for camera in site.rig)


def test_a_validation_loss_that_is_not_finite_names_the_frames(site: TinySite, tmp_path: Path) -> None:
    spoilt = network()

    def spoil(fraction: float, message: str = "", **figures: float) -> None:
        if fraction == 1.0:
            spoilt.module.heads["size"].get_parameter("bias").data.fill_(float("nan"))

    dataset = dataset_of(site)
    with pytest.raises(NonFiniteLoss) as caught:
        finetune(spoilt, replace(dataset, validation=dataset.train[:3]), options(steps=2), spoil, tmp_path)
    assert caught.value.details["step"] == 2


def test_training_needs_frames_and_placed_vehicles(site: TinySite, tmp_path: Path) -> None:
    dataset = dataset_of(site)
    with pytest.raises(TooFewInstants):
        finetune(network(), replace(dataset, train=[]), options(), silent, tmp_path)
    unplaced = site_views(site.instants, site.frames, [], site.rig)
    with pytest.raises(NoMultiViewVehicles):
        finetune(network(), replace(dataset, train=unplaced), options(), silent, tmp_path)
    alone = [
        replace(v, other_vehicle=v.other_vehicle[:0], other_camera=v.other_camera[:0], other_boxes=v.other_boxes[:0])
        for v in dataset.train
    ]
    with pytest.raises(NoMultiViewVehicles):
        finetune(network(), replace(dataset, train=alone), options(method="paper"), silent, tmp_path)


def test_trains_without_validation_frames(site: TinySite, tmp_path: Path) -> None:
    result = finetune(network(), replace(dataset_of(site), validation=[]), options(steps=2), silent, tmp_path)
    assert result.epochs[0].validation == {}
    assert result.kept == "last"
    assert np.isfinite(result.epochs[0].train["total"])


def test_the_best_weights_are_kept_where_validation_says_that_the_last_are_worse(
    site: TinySite, tmp_path: Path
) -> None:
    """After the first epoch the network forgets all it learned about sizes, by the hand of this test."""
    learning = network()
    bias = learning.module.heads["size"].get_parameter("bias")
    kept: dict[str, torch.Tensor] = {}

    def forget(fraction: float, message: str = "", **figures: float) -> None:
        if "validation_loss" in figures and not kept:
            kept.update({name: value.clone() for name, value in learning.module.state_dict().items()})
            with torch.no_grad():
                bias.fill_(25.0)

    result = finetune(learning, dataset_of(site), options(learning_rate=1e-6), forget, tmp_path)
    assert (result.kept, result.kept_step) == ("best", 2)
    for name, value in result.network.module.state_dict().items():
        assert torch.equal(value, kept[name]), name


def test_the_published_method_sees_every_image_as_the_camera_hangs(
    site: TinySite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ours zooms some; the published loss compares with other cameras, whose geometry would not change with it."""
    focal_lengths: set[float] = set()
    maps = SmallMonocular.maps

    def watched(self: SmallMonocular, views: Sequence[LabelledView], share: slice) -> dict[str, torch.Tensor]:
        focal_lengths.update(round(float(view.camera.K[0, 0]), 6) for view in views)
        return maps(self, views, share)

    monkeypatch.setattr(SmallMonocular, "maps", watched)
    dataset = replace(dataset_of(site), validation=[])
    assert len({float(camera.K[0, 0]) for camera in site.rig.values()}) == 1
    finetune(network(), dataset, options(method="paper"), silent, tmp_path / "paper")
    assert len(focal_lengths) == 1
    finetune(network(), dataset, options(method="lifted"), silent, tmp_path / "lifted")
    assert len(focal_lengths) > 3
