"""The fine-tuning stage from files to files."""

from pathlib import Path

import pytest
import torch

from tests.builders import site_of
from tests.site_dataset import give_tiny_site, tiny_rig, without_detection
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.config import FinetuneConfig
from wibam_core.networks.registry import load_network, read_card
from wibam_core.networks.small.network import SmallMonocular
from wibam_core.networks.small.onnx_network import OnnxNetwork
from wibam_core.scene import CameraRig
from wibam_core.stages import finetune
from wibam_core.stages.base import Summary
from wibam_core.training.multiview import OtherCameras


def folders_of(folder: Path) -> StageFolders:
    return give_tiny_site(folder, left_out=frozenset({8}))


def run(folders: StageFolders, config: FinetuneConfig) -> Summary:
    return finetune.run(folders.context("finetune", site_of(tiny_rig())), config)


def test_a_network_sees_images_as_wide_as_the_options_say(tmp_path: Path) -> None:
    folders = folders_of(tmp_path)
    run(folders, FinetuneConfig(steps=1, batch_size=1, input_width_px=320))
    assert load_network(folders.read(catalogue.WEIGHTS)).view_width_px == 320
    assert OnnxNetwork.load(folders.read(catalogue.WEIGHTS_ONNX)).card.input_width_px == 320


def test_what_one_camera_overlooked_is_learned_from_but_not_by_the_published_method(tmp_path: Path) -> None:
    for method, boxes in (("lifted", 6), ("paper", 4)):
        folders = folders_of(tmp_path / method)
        instants = folders.read(catalogue.ANNOTATIONS)
        folders.give(catalogue.ANNOTATIONS, [without_detection(instant, "east", 0) for instant in instants])
        config = FinetuneConfig(steps=1, batch_size=1, input_width_px=320, method=method)
        assert run(folders, config)["boxes_2d"] == boxes


def test_the_other_views_are_as_wide_as_the_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    widths = []

    class Watched(OtherCameras):
        def __init__(self, rig: CameraRig, own_view: bool, input_width_px: int) -> None:
            super().__init__(rig, own_view, input_width_px)
            widths.extend(self.of([], []).cameras.size[:, 0].tolist())

    monkeypatch.setattr("wibam_core.training.finetune.OtherCameras", Watched)
    run(
        folders_of(tmp_path),
        FinetuneConfig(steps=1, batch_size=1, input_width_px=320, method="paper"),
    )
    assert widths == [320] * 6  # three cameras, and the same mirrored


def test_writes_weights_and_curves(tmp_path: Path) -> None:
    torch.set_num_threads(1)
    folders = folders_of(tmp_path)
    config = FinetuneConfig(steps=2, steps_per_epoch=1, batch_size=2)
    summary = run(folders, config)
    network = load_network(folders.read(catalogue.WEIGHTS))
    assert isinstance(network, SmallMonocular)
    images = torch.rand(1, 3, 64, 96)
    with torch.inference_mode():
        expected = network.module(images)
    found = OnnxNetwork.load(folders.read(catalogue.WEIGHTS_ONNX))(images)
    torch.testing.assert_close(vars(found), vars(expected), atol=1e-3, rtol=0)
    curves = folders.read(catalogue.CURVES)
    card = read_card(folders.read(catalogue.WEIGHTS))
    assert (card.start, card.method, card.decode, card.device) == ("small", "lifted", "refined", "auto")
    assert card.sd_factors.keys() == {"position", "z", "size", "yaw"}
    assert card.input_width_px == 640
    assert OnnxNetwork.load(folders.read(catalogue.WEIGHTS_ONNX)).card == card
    assert [epoch.step for epoch in curves.epochs] == [1, 2]
    assert all({"heat", "yaw", "total"} <= epoch.validation.keys() for epoch in curves.epochs)
    assert summary["train_frames"] == 6
    assert summary["validation_frames"] == 3
    assert summary["pseudo_labels_3d"] == summary["boxes_2d"] == 6  # one of the two vehicles belongs to another part
    # a killed attempt left its checkpoint: the next one has nothing left to train
    assert run(folders, config)["last_loss"] == pytest.approx(summary["last_loss"], abs=1e-9)
