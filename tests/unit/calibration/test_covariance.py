"""Standard deviations of solved cameras: as large as the errors really are."""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders import look_at
from wibam_core.calibration.covariance import camera_covariance
from wibam_core.calibration.homography import solve_ground_camera
from wibam_core.calibration.pnp import solve_pose
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane

ROAD = np.array([[-9, -6], [-4, 5], [3, -3], [8, 7], [2, 9], [-3, -2], [9, 2], [-7, 3]], dtype=float)
GROUND = np.concatenate([ROAD, np.zeros((8, 1))], axis=1)
RAISED = np.concatenate([GROUND, [[-9, -6, 3.2], [8, 7, 4.0], [3, -3, 2.5]]])
UTM = np.array([691_234.5, 5_334_567.25, 0.0])
CAMERA = look_at((-20.0, -15.0, 8.0), focal_px=700.0, dist=(-0.1, 0.02, 1e-3, -1e-3))
PINHOLE = look_at((-20.0, -15.0, 8.0), focal_px=700.0)
TRIALS = 150


def rotation_error_rad(found: Camera, truth: Camera) -> np.ndarray:
    """About the camera's own axes, to first order."""
    turned = truth.T_world_cam.rotation.T @ found.T_world_cam.rotation
    return np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2


def off_middle(rng: np.random.Generator) -> Camera:
    """A camera whose principal point lies off the middle as those of real ones do, by 2 % of the width."""
    K = np.array(PINHOLE.K)
    K[:2, 2] += rng.normal(0, 0.02 * 640, 2)
    return Camera(K, np.zeros(0), PINHOLE.T_world_cam, 640, 360)


def solved(kind: str, points: np.ndarray, rng: np.random.Generator) -> tuple[Camera, Camera, np.ndarray]:
    """A camera from noisy clicks, the truth, and the clicks."""
    truth = CAMERA if kind == "pnp" else off_middle(rng)
    pixels = truth.project(points)[0] + rng.normal(0, 0.5, (len(points), 2))
    if kind == "pnp":
        pose = solve_pose(points + UTM, pixels, truth.K, truth.dist)
        return Camera(truth.K, truth.dist, pose.T_world_cam, 640, 360), truth, pixels
    return solve_ground_camera((points + UTM)[:, :2], pixels, 640, 360).camera, truth, pixels


@pytest.mark.parametrize(
    ("kind", "points"), [("pnp", RAISED), ("pnp", GROUND), ("pnp", RAISED[::2]), ("homography", GROUND)]
)
def test_nineteen_of_twenty_errors_lie_within_two_standard_deviations(kind: str, points: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    scaled, on_ground = [], []
    for _ in range(TRIALS):
        camera, truth, pixels = solved(kind, points, rng)
        found = camera_covariance(camera, points + UTM, pixels, solved_focal=kind == "homography")
        assert found is not None
        errors = [*np.degrees(rotation_error_rad(camera, truth)), *(camera.centre_m - UTM - truth.centre_m)]
        sd = [*found.rotation_sd_deg, *found.position_sd_m]
        if kind == "homography":
            errors.append(camera.K[0, 0] - truth.K[0, 0])
            sd.append(found.focal_sd_px or 0.0)
        else:
            assert found.focal_sd_px is None
        ground = np.array([[0.0, 0.0, 0.0], [6.0, -2.0, 0.0], [-2.0, 6.0, 0.0]])
        seen = truth.project(ground)[0]
        off_m = np.linalg.norm((intersect_plane(camera, seen) - UTM - ground)[:, :2], axis=1)
        on_ground.append(off_m / found.ground_sd_m(ground + UTM))
        scaled.append(np.array(errors) / sd)
    assert np.sqrt(np.mean(np.square(on_ground))) == pytest.approx(1.0, abs=0.25)
    inside = (np.abs(np.array(scaled)) < 2).mean(axis=0)
    assert (inside > 0.9).all() and (inside < 0.995).all()


def test_errors_of_rotation_and_position_go_together_as_stated() -> None:
    """Squared errors weighed by the whole covariance have the mean that they should: one a number."""
    rng = np.random.default_rng(1)
    weighed = []
    for _ in range(TRIALS):
        camera, truth, pixels = solved("pnp", RAISED, rng)
        found = camera_covariance(camera, RAISED + UTM, pixels, solved_focal=False)
        assert found is not None
        error = np.concatenate([rotation_error_rad(camera, truth), camera.centre_m - UTM - truth.centre_m])
        weighed.append(error @ np.linalg.solve(found.matrix, error) / 6)
    assert 0.8 < np.mean(weighed) < 1.25


@pytest.mark.parametrize(("kind", "count"), [("pnp", 4), ("homography", 4)])
def test_too_few_points_say_nothing(kind: str, count: int) -> None:
    camera, _, pixels = solved(kind, GROUND[:count], np.random.default_rng(2))
    assert camera_covariance(camera, GROUND[:count] + UTM, pixels, solved_focal=kind == "homography") is None
