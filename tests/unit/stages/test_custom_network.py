"""A site's own CenterTrack weights: where fine-tuning starts, what evaluation compares with, what tracks."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import safetensors
import torch
from safetensors.torch import load_file, save_file

from tests.builders import site_of
from tests.site_dataset import give_tiny_site, tiny_rig
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.config import EvaluateConfig, FinetuneConfig, PipelineConfig, PreflightConfig, TrackConfig
from wibam_core.errors import InvalidOption, InvalidWeights, UnreadableVideo
from wibam_core.models.frames import Frame
from wibam_core.networks.dla34 import train as dla34
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.networks.weights import centertrack_metadata, load_centertrack, save_network, usage_of
from wibam_core.scene import Vehicles3D
from wibam_core.stages import evaluate, finetune, preflight, track
from wibam_core.stages.runner import SiteFolder, StageUpdate, run_pipeline
from wibam_core.stages.store import StageStore

CUSTOM = FinetuneConfig(network="custom", steps=1, batch_size=1, steps_per_epoch=1)


@pytest.fixture(autouse=True)
def _small_input_and_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dla34, "LONG_SIDE_PX", 64)
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "network.safetensors"
    torch.manual_seed(0)
    save_network(DLA34(), path, {"licence": "for trying out", "source_name": "theirs.pth"})
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
    after, before = load_centertrack(tuned), load_centertrack(weights)
    assert not torch.equal(after.hm[2].bias, before.hm[2].bias)
    with safetensors.safe_open(str(tuned), "pt") as file:
        assert {"licence": "for trying out", "source_name": "theirs.pth"}.items() <= file.metadata().items()
    assert usage_of(tuned).decode == "plane"
    assert folders.read(catalogue.CURVES).network == "custom"

    used: list[tuple[float, tuple[str, ...]]] = []

    def nothing_each(
        network: DLA34, frames: Iterable[Frame], *, min_score: float, decodes: tuple[str, ...]
    ) -> Iterator[tuple[Vehicles3D, ...]]:
        used.append((float(network.hm[2].bias[0].detach()), decodes))
        for frame in frames:
            nothing = Vehicles3D.of(frame.time_ns, torch.zeros(0, 7).numpy(), camera_id=frame.camera_id)
            yield (nothing,) * len(decodes)

    def nothing(network: DLA34, frames: Iterable[Frame], *, min_score: float, decode: str) -> Iterator[Vehicles3D]:
        return (found for (found,) in nothing_each(network, frames, min_score=min_score, decodes=(decode,)))

    folders.give(catalogue.CURVES, folders.read(catalogue.CURVES).model_copy(update={"device": "cuda"}))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(evaluate, "predict_vehicles_each", nothing_each)
    monkeypatch.setattr(track, "predict_vehicles", nothing)
    evaluate.run(folders.context("evaluate", site, assets=assets), EvaluateConfig())
    start, end = (float(one.hm[2].bias[0].detach()) for one in (before, after))
    assert used == [(start, ("plane", "depth")), (end, ("plane",))]
    track.run(folders.context("track", site), TrackConfig())
    assert used[2:] == [(end, ("plane",))]


def test_what_cannot_be_used_is_refused_before_anything_is_read(tmp_path: Path, weights: Path) -> None:
    def refused(error: type[Exception], said: str, config: FinetuneConfig = CUSTOM, **assets: Path) -> None:
        nothing = StageFolders(tmp_path / "nothing")
        with pytest.raises(error, match=said):
            finetune.run(nothing.context("finetune", site_of(tiny_rig()), assets=assets), config)

    save_network(SmallNetwork(), tmp_path / "small")
    refused(InvalidWeights, "family is 'wibam-small', not 'centertrack-dla34'", network=tmp_path / "small")
    changed: dict[str, Any] = load_file(str(weights))
    changed["dep.2.bias"] = torch.zeros(2)
    save_file(changed, str(tmp_path / "changed"), metadata=centertrack_metadata())
    refused(InvalidWeights, r"tensor dep.2.bias has shape \(2,\), not \(1,\)", network=tmp_path / "changed")
    if not torch.cuda.is_available():
        refused(InvalidOption, "no CUDA device", FinetuneConfig(device="cuda"))


def test_one_that_cannot_be_used_is_refused_by_the_first_stage(tmp_path: Path) -> None:
    (tmp_path / "video").write_bytes(b"no video")
    save_network(SmallNetwork(), tmp_path / "network")
    recordings = dict.fromkeys(site_of().camera_ids, tmp_path / "video")
    folder = SiteFolder(site_of(), recordings, {"network": tmp_path / "network"})
    custom = PipelineConfig.parse({"finetune": {"network": "custom"}})
    with pytest.raises(InvalidWeights, match="the site's network: network: family is 'wibam-small'"):
        run_pipeline(folder, StageStore(tmp_path / "store"), custom)
    with pytest.raises(UnreadableVideo):  # nothing reads it
        run_pipeline(folder, StageStore(tmp_path / "store"), PipelineConfig())


def test_preflight_names_the_first_tensor_that_does_not_fit(tmp_path: Path, weights: Path) -> None:
    changed: dict[str, Any] = load_file(str(weights))
    del changed["dep.2.bias"]
    save_file(changed, str(tmp_path / "changed"), metadata=centertrack_metadata())
    site, folders = site_of(tiny_rig()), StageFolders(tmp_path / "stages")
    there = dict.fromkeys(site.camera_ids, tmp_path / "changed")
    with pytest.raises(InvalidWeights, match=r"the site's network: changed lacks the tensor dep\.2\.bias"):
        preflight.run(folders.context("preflight", site, there, {"network": tmp_path / "changed"}), PreflightConfig())
    with pytest.raises(UnreadableVideo):  # its own is in order
        preflight.run(folders.context("preflight", site, there, {"network": weights}), PreflightConfig())


def test_a_device_that_is_not_there_is_refused_before_the_first_stage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    (tmp_path / "video").write_bytes(b"no video")
    folder = SiteFolder(site_of(), dict.fromkeys(site_of().camera_ids, tmp_path / "video"), {})
    config = PipelineConfig.parse({"finetune": {"device": "cuda"}})
    updates: list[StageUpdate] = []
    with pytest.raises(InvalidOption, match="no CUDA device"):
        run_pipeline(folder, StageStore(tmp_path / "store"), config, updates.append)
    assert updates == []
    with pytest.raises(UnreadableVideo):  # what does not train needs no device
        run_pipeline(folder, StageStore(tmp_path / "store"), config, updates.append, until="sync")


def test_it_states_no_uncertainties_to_fuse_by() -> None:
    with pytest.raises(InvalidOption, match="no uncertainties"):
        PipelineConfig.parse({"finetune": {"network": "custom", "decode": "fused"}})
