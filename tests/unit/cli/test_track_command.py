from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.builders import corner_rig
from tests.recordings import write_recording
from wibam_core.cli.app import app
from wibam_core.errors import CalibrationError, MissingCamera
from wibam_core.formats.rig import write_rig
from wibam_core.formats.tracks import read_tracks


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
