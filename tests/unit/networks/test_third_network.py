"""A network of a third family goes through the unchanged stages: one package, and one line in the registry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.builders import site_of
from tests.site_dataset import give_tiny_site, tiny_rig
from tests.stage_folders import StageFolders
from tests.tiny_network import CARD, TinyNetwork
from wibam_core.artifacts import catalogue
from wibam_core.config import EvaluateConfig, FinetuneConfig, PipelineConfig, TrackConfig
from wibam_core.errors import InvalidOption, InvalidWeights
from wibam_core.networks import registry
from wibam_core.networks.registry import load_network, read_card, save_network
from wibam_core.road_users import RoadUserClass
from wibam_core.stages import evaluate, finetune, predict, track

OPTIONS = FinetuneConfig(network="custom", steps=150, steps_per_epoch=50, batch_size=3)


@pytest.fixture(autouse=True)
def _the_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry.FAMILIES, "tiny", "tests.tiny_network")
    torch.set_num_threads(1)


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    save_network(TinyNetwork(), tmp_path / "network.safetensors")
    return tmp_path / "network.safetensors"


@pytest.fixture
def folders(tmp_path: Path) -> StageFolders:
    return give_tiny_site(tmp_path / "stages")


def test_it_trains_evaluates_and_tracks(folders: StageFolders, weights: Path) -> None:
    site, assets = site_of(tiny_rig()), {"network": weights}
    summary = finetune.run(folders.context("finetune", site, assets=assets), OPTIONS)
    assert summary["last_loss"] < 0.8 * summary["first_loss"]
    assert summary["boxes_2d"] == 6  # the car alone, by three cameras, at two instants
    assert [caution.code for caution in folders.warnings if caution.details.get("boxes_2d")] == ["classes_not_taught"]
    card = read_card(folders.read(catalogue.WEIGHTS))
    assert card == CARD.model_copy(
        update={
            "start": "custom",
            "method": "lifted",
            "device": "auto",
            "sd_factors": dict.fromkeys(("position", "z", "size", "yaw"), 1.0),
        }
    )
    assert not folders.place(catalogue.WEIGHTS_ONNX).exists()

    tracking = TrackConfig(rate_hz=2.5, min_hits=1)
    predict.run(folders.context("predict", site), PipelineConfig(track=tracking).predict)
    evaluate.run(folders.context("evaluate", site, assets=assets), EvaluateConfig())
    metrics = folders.read(catalogue.METRICS)
    assert set(metrics.self_consistency) == {"baseline", "finetuned"}  # it can place boxes in one way only
    sizes_m = [found.boxes[:, 3:6] for found in folders.read(catalogue.PREDICTIONS_FINETUNED)]
    np.testing.assert_allclose(np.median(np.concatenate(sizes_m), axis=0), [4.4, 1.8, 1.5], rtol=0.1)

    track.run(folders.context("track", site), tracking)
    tracks = folders.read(catalogue.TRACKS)
    assert tracks and all(found.vehicle_class is RoadUserClass.CAR for found in tracks)


def test_what_it_saves_it_loads(folders: StageFolders, weights: Path) -> None:
    network = load_network(weights)
    assert isinstance(network, TinyNetwork)
    torch.manual_seed(0)
    for name, value in TinyNetwork().module.state_dict().items():
        assert torch.equal(value, network.module.state_dict()[name])
    with pytest.raises(InvalidWeights, match="does not exist"):
        load_network(weights.with_name("none.safetensors"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"decode": "refined"}, r"finetune\.decode: network 'custom' has no footprints, only 'plane'"),
        ({"decode": "depth"}, r"finetune\.decode: network 'custom' has no such way, only 'plane'"),
        ({"method": "combined"}, r"finetune\.method: network 'custom' cannot be trained by it, only by 'lifted'"),
    ],
)
def test_its_family_says_which_options_it_knows(
    folders: StageFolders, weights: Path, options: dict[str, str], said: str
) -> None:
    context = folders.context("finetune", site_of(tiny_rig()), assets={"network": weights})
    with pytest.raises(InvalidOption, match=said):
        finetune.run(context, OPTIONS.model_copy(update=options))
