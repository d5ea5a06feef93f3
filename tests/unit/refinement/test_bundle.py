"""The unknowns of cameras: what changes them, and what they do to pixels."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.builders import look_at
from wibam_core.config import RefineConfig
from wibam_core.documents.calibration import CalibrationResiduals, CameraResiduals
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.refinement.cameras import K1, LOG_FOCAL, changed, slopes_by_lens
from wibam_core.refinement.prior import prior_of
from wibam_core.refinement.unchanged import known_covariances
from wibam_core.scene import CameraRig

CAMERA = look_at((20.0, -12.0, 8.0))
POINTS = np.array([[2.0, 1.0, 0.0], [-4.0, 3.0, 1.5], [5.0, -6.0, 0.5], [8.0, 2.0, 1.0]])


def pixels(change: list[float]) -> np.ndarray:
    """Of the points, through the camera that was changed."""
    rig = changed(CameraRig({"a": CAMERA}), np.array([change]))
    return rig["a"].project(POINTS)[0]


def test_a_change_turns_a_camera_about_its_own_axes_and_moves_it_along_the_worlds() -> None:
    moved = changed(CameraRig({"a": CAMERA}), np.array([[0.0, 0.0, 0.01, 0.5, 0.0, -0.25]]))["a"]
    assert moved.centre_m == pytest.approx(CAMERA.centre_m + [0.5, 0.0, -0.25])
    forward, right = CAMERA.T_world_cam.rotation[:, 2], CAMERA.T_world_cam.rotation[:, 0]
    assert moved.T_world_cam.rotation[:, 2] == pytest.approx(forward)
    assert moved.T_world_cam.rotation[:, 0] @ right == pytest.approx(np.cos(0.01))


def test_focal_length_and_distortion_move_pixels_away_from_the_middle() -> None:
    straight = pixels([0.0] * 8)
    middle = CAMERA.K[:2, 2]
    longer = pixels([0.0] * 6 + [np.log(1.1), 0.0])
    assert longer - middle == pytest.approx(1.1 * (straight - middle))
    squared = ((CAMERA.undistort(straight)) ** 2).sum(axis=1, keepdims=True)
    barrel = pixels([0.0] * 6 + [0.0, -0.05])
    assert barrel - middle == pytest.approx((1 - 0.05 * squared) * (straight - middle), rel=1e-4)


@pytest.mark.parametrize("column", [LOG_FOCAL, K1])
def test_slopes_by_the_lens_are_differences_of_pixels(column: int) -> None:
    cameras = CameraTensors.from_cameras([CAMERA], torch.float64)[torch.zeros((1, 1), dtype=torch.int64)]
    found = slopes_by_lens(cameras, torch.as_tensor(CAMERA.to_camera(POINTS))[None, None], column)[0, 0]
    step = np.zeros(8)
    step[column] = 1e-4
    whole = (pixels(step.tolist()) - pixels((-step).tolist())) / 2e-4
    assert found == pytest.approx(whole[np.arange(4), np.arange(4) % 2], rel=1e-3)


def residuals(covariance: np.ndarray | None) -> CameraResiduals:
    return CameraResiduals(
        kind="pnp",
        position_m=[0.0, 0.0, 8.0],
        focal_px=[500.0, 500.0],
        covariance=None if covariance is None else covariance.tolist(),
        points=9,
        rejected=0,
        median_px=0.5,
        rms_px=0.6,
        max_px=1.0,
        median_m=0.05,
        zones=[],
        residuals=[],
    )


def test_points_hold_a_camera_by_their_covariance_and_ready_matrices_by_the_options() -> None:
    rig = CameraRig({"points": CAMERA, "matrices": CAMERA})
    given = np.diag([0.01, 0.02, 0.03, 0.5, 0.6, 0.7, 0.001, 4.0, 4.0])  # the focal length was solved, too
    both = CalibrationResiduals(cameras={"points": residuals(given), "matrices": residuals(None)})
    config = RefineConfig(rotation_sd_deg=1.0, position_sd_m=0.2, intrinsics="focal")
    prior = prior_of(rig, both, config)
    assert prior.covariance.shape == (2, 7, 7)
    assert np.diagonal(prior.covariance[0])[:6] == pytest.approx(np.diagonal(given)[:6], rel=1e-2)
    assert np.sqrt(np.diagonal(prior.covariance[1])[:6]) == pytest.approx([np.radians(1.0)] * 3 + [0.2] * 3)
    assert set(known_covariances(rig, both)) == {"points"}
