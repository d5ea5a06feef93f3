from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from tests.builders import corner_rig
from tests.recordings import write_recording
from wibam_core.cli.app import app
from wibam_core.errors import CalibrationError, InvalidWeights, MissingCamera
from wibam_core.formats.rig import write_rig
from wibam_core.formats.tracks import read_tracks
from wibam_core.models.convert import convert_checkpoint
from wibam_core.models.dla34 import DLA34
from wibam_core.models.export import export_small
from wibam_core.models.weights import bundled, load_network
from wibam_core.scene import VehicleClass
from wibam_core.video.decode import decode
from wibam_core.video.encode import VideoWriter


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "video.mp4", seconds=1.0, width_px=64, height_px=36)


def run(*arguments: str | Path) -> str:
    result = CliRunner().invoke(app, ["track", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


def test_without_a_calibration_it_says_that_metres_are_nominal(video: Path, tmp_path: Path) -> None:
    out = tmp_path / "tracks.parquet"
    assert "uncalibrated" in run(video, "--out", out, "--rate", "2")
    assert read_tracks(out) == []  # noise holds no vehicle


def test_with_a_calibration_it_does_not(video: Path, tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.json", corner_rig(2))
    options = ("--calibration", tmp_path / "rig.json", "--camera", "cam2", "--rate", "2")
    assert "nominal" not in run(video, "--out", tmp_path / "tracks.parquet", *options)


def test_a_camera_or_shape_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    square = write_recording(tmp_path / "square.mp4", seconds=0.5, width_px=64, height_px=64)
    write_rig(tmp_path / "rig.json", corner_rig(2))
    with pytest.raises(MissingCamera, match="no camera cam9"):
        run(square, "--calibration", tmp_path / "rig.json", "--camera", "cam9")
    with pytest.raises(CalibrationError, match="640x360"):
        run(square, "--calibration", tmp_path / "rig.json")


def test_a_model_may_be_onnx(video: Path, tmp_path: Path) -> None:
    torch.set_num_threads(1)
    export_small(load_network(bundled("mono_small.safetensors")), tmp_path / "model.onnx")
    out = tmp_path / "tracks.parquet"
    run(video, "--out", out, "--rate", "2", "--weights", tmp_path / "model.onnx")
    assert read_tracks(out) == []
    with pytest.raises(InvalidWeights, match="wibam-centre"):
        run(video, "--out", out, "--weights", bundled("detector2d.onnx"))


@pytest.fixture(scope="module")
def centertrack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Converted weights, random but for heads that see cars about 20 m away wherever the noise is bright."""
    folder = tmp_path_factory.mktemp("centertrack")
    torch.set_num_threads(1)
    torch.manual_seed(0)
    network = DLA34()
    with torch.no_grad():
        for head, values in {"dim": [1.6, 1.9, 4.5], "dep": [-3.0], "wh": [20.0, 15.0]}.items():
            network.get_submodule(head)[2].bias.copy_(torch.tensor(values))
        network.hm[2].bias[0] = 2.0
        network.hm[2].weight.normal_(std=0.3)
    torch.save({"state_dict": network.state_dict()}, folder / "w.pth")
    convert_checkpoint(folder / "w.pth", folder / "w.safetensors")
    return folder / "w.safetensors"


@pytest.mark.parametrize("calibrated", [True, False])
def test_centertracks_weights_are_the_detector(centertrack: Path, tmp_path: Path, calibrated: bool) -> None:
    noise = write_recording(tmp_path / "noise.mp4", seconds=0.5, fps=8.0, width_px=64, height_px=36)
    write_rig(tmp_path / "rig.json", corner_rig(2))
    options = ("--calibration", tmp_path / "rig.json") if calibrated else ()
    out = tmp_path / "tracks.parquet"
    said = run(noise, "--out", out, "--weights", centertrack, "--rate", "8", *options)
    assert "non-commercial use only" in said
    assert ("uncalibrated" in said) != calibrated
    tracks = read_tracks(out)
    assert tracks
    for track in tracks:
        assert track.vehicle_class is VehicleClass.CAR
        np.testing.assert_allclose(track.boxes[:, 3:6], [[4.5, 1.9, 1.6]] * len(track), atol=0.5)


@pytest.mark.assets
def test_centertracks_network_runs_on_the_real_clip(assets: Path, centertrack: Path, tmp_path: Path) -> None:
    first = list(islice(decode(assets / "footage" / "traffic.mp4"), 5))
    height_px, width_px = first[0][1].shape[:2]
    with VideoWriter(tmp_path / "first.mp4", width_px, height_px, 24.0) as writer:
        for time_ns, image in first:
            writer.write(image, time_ns)
    run(tmp_path / "first.mp4", "--out", tmp_path / "tracks.parquet", "--weights", centertrack, "--rate", "24")
    tracks = read_tracks(tmp_path / "tracks.parquet")
    assert tracks
    assert all(np.isfinite(track.boxes).all() for track in tracks)
