"""Cameras of which nothing is known but points: the lens comes out with the pose, or is refused."""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders import look_at
from wibam_core.calibration.covariance import camera_covariance
from wibam_core.calibration.rig import solve_camera
from wibam_core.calibration.unknown_lens import solve_unknown_lens
from wibam_core.config import CalibrateConfig
from wibam_core.errors import CalibrationError
from wibam_core.geometry.ground import intersect_plane
from wibam_core.site import SiteCamera

ROAD = [[-9, -6], [-4, 5], [3, -3], [8, 7], [2, 9], [-3, -2], [9, 2], [-7, 3], [-13, -8], [-10, 6], [-14, -3]]
POINTS = np.array([[*xy, 0.0] for xy in ROAD] + [[-9, -6, 3.2], [8, 7, 4.0], [3, -3, 2.5], [-4, 5, 3.0]], dtype=float)
UTM = np.array([691_234.5, 5_334_567.25, 0.0])
BENT = look_at((-20.0, -15.0, 8.0), focal_px=480.0, dist=(-0.25, 0.0, 0.0, 0.0))


def described(points: np.ndarray, pixels: np.ndarray) -> SiteCamera:
    pairs = [{"world": w.tolist(), "pixel": p.tolist()} for w, p in zip(points, pixels, strict=True)]
    given = {"kind": "points", "correspondences": pairs}
    return SiteCamera.model_validate({"id": "a", "width_px": 640, "height_px": 360, "calibration": given})


def seen(rng: np.random.Generator, click_px: float = 0.5, points: np.ndarray = POINTS) -> np.ndarray:
    return np.asarray(BENT.project(points)[0] + rng.normal(0, click_px, (len(points), 2)))


def test_exact_points_give_the_lens_and_the_pose() -> None:
    solved = solve_unknown_lens(POINTS + UTM, BENT.project(POINTS)[0], 640, 360)
    assert solved.used.all()
    # what is not known, the principal point and k1, is held a little
    assert solved.camera.K[0, 0] == pytest.approx(480.0, rel=0.01)
    assert solved.camera.dist[0] == pytest.approx(-0.25, abs=0.02)
    assert solved.camera.centre_m - UTM == pytest.approx(BENT.centre_m, abs=0.2)


def test_a_wrong_click_is_left_out() -> None:
    rng = np.random.default_rng(0)
    pixels = seen(rng)
    pixels[[2, 6]] += [[40.0, -30.0], [-45.0, -40.0]]
    result = solve_camera(described(POINTS + UTM, pixels), CalibrateConfig())
    assert (~result.used).nonzero()[0].tolist() == [2, 6]
    assert result.camera.K[0, 0] == pytest.approx(480.0, rel=0.05)
    assert any("left out" in caution.message for caution in result.cautions)


def test_stated_standard_deviations_hold_the_errors() -> None:
    """Also those of places on the ground, with principal points off the middle as those of real cameras are."""
    rng = np.random.default_rng(1)
    errors, on_ground = [], []
    places = np.array([[0.0, 0.0, 0.0], [6.0, -2.0, 0.0], [-4.0, 3.0, 0.0]])
    for _ in range(80):
        k1 = float(np.clip(rng.normal(0, 0.12), -0.25, 0.25))
        truth = look_at((-20.0, -15.0, 8.0), focal_px=480.0, dist=(k1, 0.0, 0.0, 0.0))
        K = np.array(truth.K)
        K[:2, 2] += rng.normal(0, 0.02 * 640, 2)
        truth = type(truth)(K, truth.dist, truth.T_world_cam, 640, 360)
        pixels = truth.project(POINTS)[0] + rng.normal(0, 0.5, POINTS[:, :2].shape)
        found = solve_unknown_lens(POINTS, pixels, 640, 360).camera
        stated = camera_covariance(found, POINTS, pixels, solved_focal=True, solved_k1=True)
        assert stated is not None and stated.focal_sd_px is not None and stated.k1_sd is not None
        off = [*(found.centre_m - truth.centre_m), found.K[0, 0] - 480.0, found.dist[0] - truth.dist[0]]
        errors.append(np.array(off) / [*stated.position_sd_m, stated.focal_sd_px, stated.k1_sd])
        off_m = (intersect_plane(found, truth.project(places)[0]) - places)[:, :2]
        on_ground.append(np.linalg.norm(off_m, axis=1) / stated.ground_sd_m(places))
    assert np.sqrt(np.mean(np.square(on_ground))) == pytest.approx(1.0, abs=0.3)
    assert ((np.abs(errors) < 2).mean(axis=0) > 0.88).all()


def test_the_document_says_focal_length_and_k1() -> None:
    result = solve_camera(described(POINTS, seen(np.random.default_rng(2))), CalibrateConfig())
    document = result.document()
    assert document.kind == "points" and document.focal_sd_px and document.k1_sd
    assert abs(document.focal_px[0] - 480.0) < 3 * document.focal_sd_px
    assert document.k1 is not None and abs(document.k1 + 0.25) < 3 * document.k1_sd
    assert np.shape(document.covariance) == (10, 10)


def test_points_that_do_not_tell_the_focal_length_are_refused_with_what_to_do() -> None:
    """All on the road beneath a camera that looks nearly straight down: nearer and longer look the same."""
    camera = look_at((0.5, 0.5, 12.0), focal_px=480.0)
    points = np.array([[x, y, 0.0] for x in (-3.0, 0.0, 3.0) for y in (-2.0, 2.0)])
    pixels = camera.project(points)[0] + np.random.default_rng(3).normal(0, 0.5, (6, 2))
    with pytest.raises(CalibrationError, match="do not tell the focal length") as refused:
        solve_camera(described(points, pixels), CalibrateConfig())
    assert "raised" in (refused.value.hint or "")


def test_too_few_points_are_refused_with_what_to_do() -> None:
    with pytest.raises(CalibrationError, match="too few to tell the lens") as refused:
        solve_camera(described(POINTS[:5], BENT.project(POINTS[:5])[0]), CalibrateConfig())
    assert "pnp" in (refused.value.hint or "")


def test_a_mirrored_world_is_named() -> None:
    mirrored = POINTS * [-1.0, 1.0, 1.0]
    with pytest.raises(CalibrationError, match="mirrored"):
        solve_camera(described(mirrored, seen(np.random.default_rng(4))), CalibrateConfig())
