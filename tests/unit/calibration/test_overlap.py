from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.builders import look_at, site_of
from tests.stage_folders import StageFolders
from wibam_core.artifacts.catalogue import RESIDUALS
from wibam_core.calibration.overlap import overlap_cautions, overlap_of
from wibam_core.config import CalibrateConfig
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.stages import calibrate as stage


def from_above(x_m: float, y_m: float, height_m: float = 20.0) -> Camera:
    """A camera that looks straight down on 32 by 18 m of road: pixels are 5 cm."""
    K = np.array([[400.0, 0.0, 319.5], [0.0, 400.0, 179.5], [0.0, 0.0, 1.0]])
    down = np.diag([1.0, -1.0, -1.0])
    return Camera(K, np.zeros(0), SE3(down, np.array([x_m, y_m, height_m])), 640, 360)


def test_areas_are_those_of_rectangles() -> None:
    overlap = overlap_of({"a": from_above(0.0, 0.0), "b": from_above(16.0, 0.0), "c": from_above(0.0, 30.0)})
    assert overlap.area_m2 == pytest.approx(dict.fromkeys("abc", 32 * 18), rel=0.06)
    shared = {tuple(pair.cameras): (pair.area_m2, pair.share) for pair in overlap.pairs}
    assert shared["a", "b"] == pytest.approx((16 * 18, 0.5), rel=0.1)
    assert shared["a", "c"] == shared["b", "c"] == (0.0, 0.0)
    assert overlap.seen_by_m2["1"] == pytest.approx(3 * 32 * 18 - 16 * 18, rel=0.06)
    assert overlap.seen_by_m2["2"] == pytest.approx(16 * 18, rel=0.1)
    assert overlap.seen_by_m2["3"] == 0


def test_a_camera_that_shares_little_is_named_with_what_it_shares() -> None:
    rig = {"a": from_above(0.0, 0.0), "b": from_above(8.0, 0.0), "c": from_above(28.0, 8.0)}
    (caution,) = overlap_cautions(overlap_of(rig))
    assert caution.code == "little_overlap" and caution.details["camera"] == "c"
    assert "Camera c" in caution.message and "with b" in caution.message
    alone = overlap_cautions(overlap_of({"a": from_above(0.0, 0.0), "b": from_above(50.0, 0.0)}))
    assert [one.details["camera"] for one in alone] == ["a", "b"]
    assert "none at all" in alone[0].message
    assert not overlap_cautions(overlap_of({"a": look_at((20.0, 0.0, 8.0))}))


def test_stage_says_it_before_anything_long_begins(tmp_path: Path) -> None:
    folders, site = StageFolders(tmp_path), site_of()
    summary = stage.run(folders.context("calibrate", site), CalibrateConfig())
    overlap = folders.read(RESIDUALS).overlap
    assert overlap is not None and len(overlap.pairs) == 6
    assert summary["shared_m2"]["cam1 and cam2"] == overlap.pairs[0].area_m2 > 210
    assert not [warning for warning in folders.warnings if warning.code == "little_overlap"]
