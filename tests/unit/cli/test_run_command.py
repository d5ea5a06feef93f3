"""`wibam run` on a site folder: what a person sees in the terminal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from tests.builders import look_at
from tests.recordings import write_recording
from wibam_core.calibration.overlap import overlap_of
from wibam_core.cli.app import app
from wibam_core.scene import site_camera
from wibam_core.site import Site

POINTS = np.array([[-9, -6, 0], [-4, 5, 0], [3, -3, 0], [8, 7, 0], [2, 9, 0], [-3, -2, 0], [9, 2, 2.5], [-7, 3, 3.0]])


def test_warnings_are_printed_when_a_stage_runs_and_when_it_is_reused(tmp_path: Path) -> None:
    camera = look_at((-20.0, -15.0, 8.0), focal_px=700.0)
    feet = (POINTS / 0.3048).tolist()
    points = [{"world": w, "pixel": p} for w, p in zip(feet, camera.project(POINTS)[0].tolist(), strict=True)]
    calibration = {"kind": "pnp", "K": camera.K.tolist(), "correspondences": points}
    entry = {"id": "pole", "width_px": 640, "height_px": 360, "calibration": calibration}
    site = Site.model_validate({"name": "feet", "cameras": [entry]})
    (tmp_path / "recordings").mkdir()
    (tmp_path / "site.json").write_text(site.model_dump_json())
    write_recording(tmp_path / "recordings" / "pole.mp4", width_px=640, height_px=360)
    options = ["--until", "calibrate", "--set", "sync.method=none", "--set", "preflight.min_overlap_s=1"]
    for state in ("succeeded", "reused"):
        done = CliRunner().invoke(app, ["run", str(tmp_path), *options], catch_exceptions=False, env={"COLUMNS": "300"})
        assert done.exit_code == 0
        assert state in done.output
        assert "warning Camera pole: the camera comes out 26.2 m above the road" in done.output
        assert "m² (" not in done.output
        assert "If these are feet, multiply them by 0.3048" in done.output


def test_what_cameras_see_together_and_what_is_not_used_is_printed_before_anything_long(tmp_path: Path) -> None:
    cameras = {"a": look_at((-20.0, -15.0, 8.0)), "b": look_at((20.0, -15.0, 8.0)), "c": look_at((20.0, 15.0, 8.0))}
    site = Site(name="three", cameras=tuple(site_camera(name, camera) for name, camera in cameras.items()))
    (tmp_path / "recordings").mkdir()
    (tmp_path / "site.json").write_text(site.model_dump_json())
    recording = write_recording(tmp_path / "recordings" / "a.mp4", seconds=1.5, width_px=640, height_px=360)
    for name in ("b", "c"):
        (tmp_path / "recordings" / f"{name}.mp4").write_bytes(recording.read_bytes())
    options = ["--until", "calibrate", "--set", "sync.method=none", "--set", "preflight.min_overlap_s=1"]
    (tmp_path / "recordings" / "north.mp4").write_bytes(recording.read_bytes())
    done = CliRunner().invoke(app, ["run", str(tmp_path), *options], catch_exceptions=False, env={"COLUMNS": "300"})
    assert done.exit_code == 0
    assert "warning recordings/north.mp4: not used, since no camera of site.json is called so" in done.output
    assert "Camera b: its recording b.mp4 is, byte by byte, the one of camera a" in done.output
    pairs = overlap_of(cameras).pairs
    assert len(pairs) == 3
    for pair in pairs:
        assert f"{' and '.join(pair.cameras)} share {pair.area_m2:.0f} m² ({pair.share:.0%}" in done.output
