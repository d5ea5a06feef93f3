from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from wibam_core.cli.detect import detect
from wibam_core.errors import InvalidWeights, UnreadableVideo

app = typer.Typer()
app.command()(detect)
runner = CliRunner()


def test_wrong_inputs_raise_what_the_command_line_shows(tmp_path: Path) -> None:
    (tmp_path / "text.onnx").write_text("no network")
    result = runner.invoke(app, [str(tmp_path / "a.mp4"), "--detector", str(tmp_path / "text.onnx")])
    assert isinstance(result.exception, InvalidWeights)


@pytest.mark.assets
def test_real_clip_has_vehicles_in_every_sampled_frame(assets: Path, tmp_path: Path) -> None:
    out = tmp_path / "boxes.json"
    arguments = [
        str(assets / "footage" / "traffic.mp4"),
        "--detector",
        str(assets / "detectors" / "yolox_nano.onnx"),
        "--out",
        str(out),
        "--threads",
        "1",
    ]
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "40 frames, 0 of them without a vehicle" in result.output
    frames = json.loads(out.read_text())
    times = np.array([frame["time_ns"] for frame in frames])
    assert len(frames) == 40
    assert (np.abs(np.diff(times) - 5e8) < 5e7).all()
    for frame in frames:
        assert frame["boxes"]
        for box in frame["boxes"]:
            x0, y0, x1, y1 = box["xyxy_px"]
            assert -0.5 <= x0 < x1 <= 639.5
            assert -0.5 <= y0 < y1 <= 359.5
            assert box["class"] in {"car", "truck", "bus"}
            assert 0.2 <= box["score"] <= 1


@pytest.mark.assets
def test_text_for_a_video_is_refused(assets: Path, tmp_path: Path) -> None:
    path = tmp_path / "notes.mp4"
    path.write_text("no film")
    result = runner.invoke(app, [str(path), "--detector", str(assets / "detectors" / "yolox_nano.onnx")])
    assert isinstance(result.exception, UnreadableVideo)
