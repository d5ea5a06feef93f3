"""The fine-tuning stage from files to files."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tests.builders import site_of
from tests.site_dataset import tiny_rig, tiny_site, without_detection
from wibam_core.config import FinetuneConfig
from wibam_core.dataset.split import Split
from wibam_core.formats.annotations import read_annotations, write_annotations
from wibam_core.formats.rig import write_rig
from wibam_core.formats.vehicles3d import write_vehicles3d
from wibam_core.models.usage import Usage
from wibam_core.networks.small.onnx_network import OnnxNetwork
from wibam_core.networks.weights import load_network, usage_of
from wibam_core.progress import silent
from wibam_core.scene import CameraRig
from wibam_core.stages import finetune
from wibam_core.stages.base import StageContext
from wibam_core.training.multiview import OtherCameras


def context_of(folder: Path) -> StageContext:
    upstream = {name: folder / name for name in ("calibrate", "frames", "associate", "dataset", "lift")}
    for path in upstream.values():
        path.mkdir()
    site = tiny_site(upstream["frames"])
    write_rig(upstream["calibrate"] / "rig.json", site.rig)
    write_annotations(upstream["associate"] / "annotations.parquet", site.instants)
    write_vehicles3d(upstream["lift"] / "lifts.parquet", site.lifts)
    times = tuple(instant.time_ns for instant in site.instants)
    nobody: frozenset[int] = frozenset()
    split = Split(
        {"train": times[:2], "val": times[2:3], "test": times[3:]},
        {"train": frozenset({8}), "val": nobody, "test": nobody},
    )
    (upstream["dataset"] / "split.json").write_text(json.dumps(split.to_json()))
    (folder / "output").mkdir()
    (folder / "scratch").mkdir()
    return StageContext(site_of(tiny_rig()), {}, {}, upstream, folder / "output", folder / "scratch", silent)


def test_a_network_sees_images_as_wide_as_the_options_say(tmp_path: Path) -> None:
    context = context_of(tmp_path)
    finetune.run(context, FinetuneConfig(steps=1, batch_size=1, input_width_px=320))
    assert load_network(context.output / "weights.safetensors").input_width_px == 320
    assert OnnxNetwork.load(context.output / "weights.onnx").input_width_px == 320
    assert json.loads((context.output / "curves.json").read_text())["input_width_px"] == 320


def test_what_one_camera_overlooked_is_learned_from_but_not_by_the_published_method(tmp_path: Path) -> None:
    context = context_of(tmp_path)
    path = context.upstream["associate"] / "annotations.parquet"
    write_annotations(path, [without_detection(instant, "east", 0) for instant in read_annotations(path)])
    for method, boxes in (("lifted", 6), ("paper", 4)):
        again = replace(context, output=tmp_path / method, scratch=tmp_path / f"{method}-scratch")
        again.output.mkdir()
        config = FinetuneConfig(steps=1, batch_size=1, input_width_px=320, method=method)
        assert finetune.run(again, config)["boxes_2d"] == boxes


def test_the_other_views_are_as_wide_as_the_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    widths = []

    class Watched(OtherCameras):
        def __init__(self, rig: CameraRig, own_view: bool, input_width_px: int) -> None:
            super().__init__(rig, own_view, input_width_px)
            widths.extend(self.of([], []).cameras.size[:, 0].tolist())

    monkeypatch.setattr("wibam_core.training.finetune.OtherCameras", Watched)
    finetune.run(context_of(tmp_path), FinetuneConfig(steps=1, batch_size=1, input_width_px=320, method="paper"))
    assert widths == [320] * 6  # three cameras, and the same mirrored


def test_writes_weights_and_curves(tmp_path: Path) -> None:
    torch.set_num_threads(1)
    context = context_of(tmp_path)
    config = FinetuneConfig(steps=2, steps_per_epoch=1, batch_size=2)
    summary = finetune.run(context, config)
    network = load_network(context.output / "weights.safetensors")
    images = torch.rand(1, 3, 64, 96)
    with torch.inference_mode():
        expected = network(images)
    found = OnnxNetwork.load(context.output / "weights.onnx")(images)
    torch.testing.assert_close(vars(found), vars(expected), atol=1e-3, rtol=0)
    curves = json.loads((context.output / "curves.json").read_text())
    assert curves["decode"] == "refined"
    assert curves["input_width_px"] == network.input_width_px == 640
    said = Usage("refined", curves["sd_factors"])
    assert said.sd_factors.keys() == {"position", "z", "size", "yaw"}
    assert usage_of(context.output / "weights.safetensors") == said
    assert OnnxNetwork.load(context.output / "weights.onnx").usage == said
    assert [epoch["step"] for epoch in curves["epochs"]] == [1, 2]
    assert all({"heat", "yaw", "total"} <= epoch["validation"].keys() for epoch in curves["epochs"])
    assert summary["train_frames"] == 6
    assert summary["validation_frames"] == 3
    assert summary["labels_3d"] == summary["boxes_2d"] == 6  # one of the two vehicles belongs to another part
    # a killed attempt left its checkpoint: the next one has nothing left to train
    again = replace(context, output=tmp_path / "again")
    again.output.mkdir()
    assert finetune.run(again, config)["last_loss"] == pytest.approx(summary["last_loss"], abs=1e-9)
