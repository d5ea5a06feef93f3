"""The unknowns of cameras: what changes them, and what they do to pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

from tests.builders import corner_rig, look_at
from tests.multiview import wide_rig
from wibam_core.calibration.covariance import ground_moves
from wibam_core.config import RefineConfig
from wibam_core.documents.calibration import CalibrationResiduals, CameraResiduals
from wibam_core.geometry.se3 import SE3
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.refinement.cameras import K1, LOG_FOCAL, changed, slopes_by_lens
from wibam_core.refinement.mounts import mounts_of, of_what_is_seen
from wibam_core.refinement.prior import ground_of, prior_of
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
    assert prior.own.shape == (2, 7, 7)
    assert np.diagonal(prior.own[0])[:6] == pytest.approx(np.diagonal(given)[:6], rel=1e-2)
    sd = np.sqrt(np.diagonal(prior.own[1])[:6])
    assert (sd <= [np.radians(1.0)] * 3 + [0.2] * 3).all() and (sd > [np.radians(0.2)] * 3 + [0.05] * 3).all()
    on_ground = ground_moves(CAMERA, POINTS[:1])[0] @ prior.own[1][:6, :6] @ ground_moves(CAMERA, POINTS[:1])[0].T
    assert 0.1 < np.sqrt(np.trace(on_ground)) < np.radians(1.0) * 30.0
    assert set(known_covariances(rig, both)) == {"points"}


def test_all_cameras_may_be_found_higher_and_tilted_together_at_little_cost() -> None:
    """The road lies lower by 0.2 m than it was taken to, and by 0.1 m more for each 10 m towards north and east."""
    rig = corner_rig()
    prior = prior_of(rig, CalibrationResiduals(cameras={}), RefineConfig())
    middle = np.mean([camera.centre_m for camera in rig.values()], axis=0)
    tilt = SE3.from_rvec_tvec([0.01, -0.01, 0.0], np.zeros(3))
    changes = []
    for camera in rig.values():
        position = middle + tilt.apply(camera.centre_m - middle) + [0.0, 0.0, 0.2]
        turn = SE3(camera.T_world_cam.rotation.T @ tilt.rotation @ camera.T_world_cam.rotation, np.zeros(3))
        changes.append([*turn.to_rvec_tvec()[0], *(position - camera.centre_m)])
    together, alone = np.array(changes), np.zeros((4, 6))
    alone[0] = changes[0]
    height_m, slope_x, slope_y = ground_of(together, prior)
    assert height_m == pytest.approx(-0.2, abs=0.02)
    assert [slope_x, slope_y] == pytest.approx([-0.01, -0.01], abs=1e-3)
    cost, cost_alone = (own.ravel() @ prior.information @ own.ravel() for own in (together, alone))
    assert cost < 5.0 and cost_alone > 1.5 * cost


def test_views_of_a_wide_lens_turn_with_the_camera_that_they_are_cut_from() -> None:
    rig = wide_rig()
    changes = np.random.default_rng(0).normal(0, [0.01] * 3 + [0.1] * 3, (4, 6))
    after = changed(rig, changes)
    mounts, turns = mounts_of(rig)
    assert mounts.tolist() == [0, 0, 1, 1, 2, 2, 3, 3] and after.views == rig.views
    for name, mount, turn in zip(rig, mounts, turns, strict=True):
        between = rig[name].T_world_cam.rotation.T @ after[name].T_world_cam.rotation
        assert cv2.Rodrigues(between)[0].ravel() == pytest.approx(turn @ changes[mount, :3], abs=1e-9)
        assert after[name].centre_m - rig[name].centre_m == pytest.approx(changes[mount, 3:])
    own = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    seen = of_what_is_seen(rig, dict.fromkeys(rig.mounted, own))
    assert tuple(seen) == tuple(rig)
    for name, turn in zip(rig, turns, strict=True):
        assert seen[name][:3, :3] == pytest.approx(turn @ own[:3, :3] @ turn.T)
        assert seen[name][3:, 3:] == pytest.approx(own[3:, 3:])
