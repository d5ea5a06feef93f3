"""A site's own CenterTrack weights: where fine-tuning starts, what evaluation compares with, what tracks."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file

from tests.builders import site_of
from tests.site_dataset import give_tiny_site, tiny_rig
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.config import EvaluateConfig, FinetuneConfig, PipelineConfig, PreflightConfig, TrackConfig
from wibam_core.errors import InvalidOption, InvalidWeights, UnreadableVideo
from wibam_core.formats.model_card import metadata_of, read_card
from wibam_core.models.frames import Frame
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.dla34.network import CARD, CenterTrack
from wibam_core.networks.registry import load_network, save_network
from wibam_core.scene import Vehicles3D
from wibam_core.stages import evaluate, finetune, predict, preflight, track
from wibam_core.stages.graph import InputDigests, plan
from wibam_core.stages.runner import SiteFolder, StageUpdate, run_pipeline
from wibam_core.stages.store import StageStore
from wibam_core.video.recording import Recording

CUSTOM = FinetuneConfig(network="custom", steps=1, batch_size=1, steps_per_epoch=1)


#: Options that CenterTrack's network has no use for, and what is said about them.
UNABLE: tuple[tuple[dict[str, Any], str], ...] = (
    ({"decode": "fused"}, r"option finetune\.decode: .* has no uncertainties to fuse by, only 'plane' and 'depth' are"),
    ({"decode": "ground"}, r"option finetune\.decode: network 'custom' has no footprints"),
    ({"input_width_px": 960}, r"option finetune\.input_width_px: network 'custom' sees images as CenterTrack does"),
)


@pytest.fixture(autouse=True)
def _small_input_and_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CenterTrack, "long_side_px", 64)
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "network.safetensors"
    torch.manual_seed(0)
    card = CARD.model_copy(update={"licence": "for trying out", "source_name": "theirs.pth"})
    save_network(CenterTrack(DLA34(), card), path)
    return path


@pytest.fixture
def folders(tmp_path: Path) -> StageFolders:
    return give_tiny_site(tmp_path)


def test_it_is_fine_tuned_compared_and_tracked_with(
    folders: StageFolders, weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site, assets = site_of(tiny_rig()), {"network": weights}
    finetune.run(folders.context("finetune", site, assets=assets), CUSTOM)
    tuned = folders.read(catalogue.WEIGHTS)
    after, before = biases(tuned), biases(weights)
    assert not torch.equal(after, before)
    card = read_card(tuned)
    assert (card.licence, card.source_name) == ("for trying out", "theirs.pth")
    assert (card.start, card.decode) == ("custom", "plane")
    assert not folders.place(catalogue.WEIGHTS_ONNX).exists()

    used: list[tuple[float, tuple[str, ...]]] = []

    def nothing(
        network: CenterTrack, frames: Iterable[Frame], *, decodes: tuple[str, ...], min_score: float
    ) -> Iterator[tuple[Vehicles3D, ...]]:
        used.append((float(network.module.hm[2].bias[0].detach()), decodes))
        for frame in frames:
            nothing = Vehicles3D.of(frame.time_ns, torch.zeros(0, 7).numpy(), camera_id=frame.camera_id)
            yield (nothing,) * len(decodes)

    trained_elsewhere = load_network(tuned)
    trained_elsewhere.card = card.model_copy(update={"device": "cuda"})
    save_network(trained_elsewhere, tuned)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(CenterTrack, "predict_each", nothing)
    predict.run(folders.context("predict", site), PipelineConfig().predict)
    evaluate.run(folders.context("evaluate", site, assets=assets), EvaluateConfig())
    start, end = float(before[0]), float(after[0])
    assert used == [(end, ("plane",))] * 2 + [(start, ("plane", "depth"))]  # in the test part, and in the rest
    track.run(folders.context("track", site), TrackConfig())
    assert len(used) == 3


def biases(path: Path) -> torch.Tensor:
    """Of the heat."""
    return load_file(str(path))["hm.2.bias"]


def test_what_cannot_be_used_is_refused_before_anything_is_read(tmp_path: Path, weights: Path) -> None:
    def refused(error: type[Exception], said: str, config: FinetuneConfig = CUSTOM, **assets: Path) -> None:
        nothing = StageFolders(tmp_path / "nothing")
        with pytest.raises(error, match=said):
            finetune.run(nothing.context("finetune", site_of(tiny_rig()), assets=assets), config)

    save_file({"any": torch.zeros(1)}, str(tmp_path / "other"), metadata={"family": "other"})
    refused(InvalidWeights, "family is 'other', not 'wibam-small' or", network=tmp_path / "other")
    changed: dict[str, Any] = load_file(str(weights))
    changed["dep.2.bias"] = torch.zeros(2)
    save_file(changed, str(tmp_path / "changed"), metadata=metadata_of(CARD))
    refused(InvalidWeights, r"tensor dep.2.bias has shape \(2,\), not \(1,\)", network=tmp_path / "changed")
    for options, why in UNABLE:
        refused(InvalidOption, why, CUSTOM.model_copy(update=options), network=weights)
    if not torch.cuda.is_available():
        refused(InvalidOption, "no CUDA device", FinetuneConfig(device="cuda"))


def test_one_that_cannot_be_used_is_refused_by_the_first_stage(tmp_path: Path) -> None:
    (tmp_path / "video").write_bytes(b"no video")
    save_file({"any": torch.zeros(1)}, str(tmp_path / "network"), metadata={"family": "other"})
    recordings = dict.fromkeys(site_of().camera_ids, Recording.at(tmp_path / "video"))
    folder = SiteFolder(site_of(), recordings, {"network": tmp_path / "network"})
    custom = PipelineConfig.parse({"finetune": {"network": "custom"}})
    with pytest.raises(InvalidWeights, match="the site's network: network: family is 'other'"):
        run_pipeline(folder, StageStore(tmp_path / "store"), custom)
    with pytest.raises(UnreadableVideo):  # nothing reads it
        run_pipeline(folder, StageStore(tmp_path / "store"), PipelineConfig())


@pytest.mark.parametrize(("options", "why"), UNABLE)
def test_options_that_it_cannot_do_are_refused_by_the_first_stage(
    tmp_path: Path, weights: Path, options: dict[str, Any], why: str
) -> None:
    (tmp_path / "video").write_bytes(b"no video")
    recordings = dict.fromkeys(site_of().camera_ids, Recording.at(tmp_path / "video"))
    folder, store = SiteFolder(site_of(), recordings, {"network": weights}), StageStore(tmp_path / "store")
    with pytest.raises(InvalidOption, match=why):
        run_pipeline(folder, store, PipelineConfig.parse({"finetune": {"network": "custom", **options}}))
    with pytest.raises(UnreadableVideo):  # it can do what is usual
        run_pipeline(folder, store, PipelineConfig.parse({"finetune": {"network": "custom"}}))


def test_what_it_is_asked_for_is_checked_again_but_reads_no_recording_again(weights: Path) -> None:
    inputs = InputDigests(dict.fromkeys(site_of().camera_ids, "a"), {"network": "b"})

    def hashes(**options: object) -> dict[str, str]:
        planned = plan(site_of(), PipelineConfig.parse({"finetune": {"network": "custom", **options}}), inputs)
        return {stage.name: stage.hash for stage in planned}

    usual = hashes()
    otherwise = {name for name, address in hashes(decode="depth").items() if address != usual[name]}
    assert otherwise == {"preflight", "finetune", "predict", "evaluate", "track", "safety", "report"}
    assert {name for name, address in hashes(steps=3).items() if address != usual[name]} == otherwise - {"preflight"}


def test_preflight_names_the_first_tensor_that_does_not_fit(tmp_path: Path, weights: Path) -> None:
    changed: dict[str, Any] = load_file(str(weights))
    del changed["dep.2.bias"]
    save_file(changed, str(tmp_path / "changed"), metadata=metadata_of(CARD))
    site, folders = site_of(tiny_rig()), StageFolders(tmp_path / "stages")
    there = dict.fromkeys(site.camera_ids, tmp_path / "changed")

    def check(network: Path) -> None:
        context = folders.context("preflight", site, there, {"network": network}, checked_options=CUSTOM)
        preflight.run(context, PreflightConfig())

    with pytest.raises(InvalidWeights, match=r"the site's network: changed lacks the tensor dep\.2\.bias"):
        check(tmp_path / "changed")
    with pytest.raises(UnreadableVideo):  # its own is in order
        check(weights)


def test_a_device_that_is_not_there_is_refused_before_the_first_stage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    (tmp_path / "video").write_bytes(b"no video")
    folder = SiteFolder(site_of(), dict.fromkeys(site_of().camera_ids, Recording.at(tmp_path / "video")), {})
    config = PipelineConfig.parse({"finetune": {"device": "cuda"}})
    updates: list[StageUpdate] = []
    with pytest.raises(InvalidOption, match="no CUDA device"):
        run_pipeline(folder, StageStore(tmp_path / "store"), config, updates.append)
    assert updates == []
    with pytest.raises(UnreadableVideo):  # what does not train needs no device
        run_pipeline(folder, StageStore(tmp_path / "store"), config, updates.append, until="sync")
