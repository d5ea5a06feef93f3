"""A site's calibration as the user gave it, to calibrated cameras."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from wibam_core.calibration.homography import solve_ground_camera
from wibam_core.calibration.matrices import (
    GROUND_RANGE_M,
    build_camera,
    camera_from_matrices,
    check_view,
    visible_ground,
)
from wibam_core.calibration.pnp import solve_pose
from wibam_core.calibration.residuals import Residuals
from wibam_core.config import CalibrateConfig
from wibam_core.errors import CalibrationError, NoOverlap
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import CameraRig
from wibam_core.site import Correspondence, MatrixCalibration, PnPCalibration, Site, SiteCamera

Array = NDArray[np.float64]

#: World points of a homography must lie this close to the ground.
_GROUND_TOLERANCE_M = 0.01


def calibrate(site: Site, config: CalibrateConfig) -> tuple[CameraRig, dict[str, Residuals]]:
    """Solve every camera of a site.

    Returns:
        the rig, and per camera the residuals of its calibration.

    Raises:
        CalibrationError: naming the camera that cannot be solved, or whose median error exceeds the limit.
        NoOverlap: naming a camera that shares no ground with the others.
    """
    residuals: dict[str, Residuals] = {}
    for camera in site.cameras:
        try:
            residuals[camera.id] = solve_camera(camera)
        except CalibrationError as error:
            details = {"camera": camera.id, **error.details}
            raise CalibrationError(f"camera {camera.id}: {error.message}", hint=error.hint, **details) from error
        _check_finite(camera.id, residuals[camera.id])
        median = residuals[camera.id].median_px
        if median is not None and median > config.max_error_px:
            raise CalibrationError(
                f"camera {camera.id}: the points are off by {median:.1f} px at the median, more than "
                f"{config.max_error_px:g} px",
                hint="Check pixels against world points, units (metres) and the intrinsics; "
                "or raise calibrate.max_error_px.",
                camera=camera.id,
                median_px=median,
            )
    rig = CameraRig({camera_id: result.camera for camera_id, result in residuals.items()})
    check_overlap(rig)
    return rig, residuals


def solve_camera(camera: SiteCamera) -> Residuals:
    """Solve one camera.

    Raises:
        CalibrationError: if it cannot be solved.
    """
    given = camera.calibration
    width_px, height_px = camera.width_px, camera.height_px
    if isinstance(given, MatrixCalibration):
        solved = camera_from_matrices(given.K, given.dist, given.rvec, given.tvec, width_px, height_px)
        return Residuals.of(given.kind, solved, np.zeros((0, 3)), np.zeros((0, 2)))
    world, pixels = _arrays(given.correspondences)
    _check_pixels(pixels, width_px, height_px)
    if isinstance(given, PnPCalibration):
        intrinsics = build_camera(given.K, given.dist, SE3.identity(), width_px, height_px)
        fit = solve_pose(world, pixels, intrinsics.K, intrinsics.dist)
        solved = build_camera(given.K, given.dist, fit.T_world_cam, width_px, height_px)
        used = fit.used
    else:
        if len(world) and np.abs(world[:, 2]).max() > _GROUND_TOLERANCE_M:
            raise CalibrationError(
                "calibration kind 'homography' takes points on the ground alone (z = 0)",
                hint="Leave out raised points, or give the intrinsics and use calibration kind 'pnp'.",
            )
        ground = solve_ground_camera(world[:, :2], pixels, width_px, height_px)
        solved, used = ground.camera, ground.used
    check_view(solved)
    return Residuals.of(given.kind, solved, world, pixels, used)


def _check_finite(camera_id: str, residuals: Residuals) -> None:
    """Refuse a camera that rests on points it cannot see.

    Raises:
        CalibrationError: naming the first of them.
    """
    unseen = residuals.used & ~np.isfinite(residuals.error_px)
    if unseen.any():
        raise CalibrationError(
            f"camera {camera_id}: {int(unseen.sum())} of {len(unseen)} points come out behind the camera, e.g. "
            f"{_place(residuals.world[unseen][0])}",
            hint="Check that each pixel belongs to its world point.",
            camera=camera_id,
        )


def _place(point: Array) -> str:
    """A point's coordinates (n,), to the centimetre."""
    return f"({', '.join(f'{value:.2f}' for value in point)})"


def _arrays(correspondences: tuple[Correspondence, ...]) -> tuple[Array, Array]:
    world = np.array([c.world for c in correspondences], dtype=np.float64).reshape(-1, 3)
    pixels = np.array([c.pixel for c in correspondences], dtype=np.float64).reshape(-1, 2)
    return world, pixels


def _check_pixels(pixels: Array, width_px: int, height_px: int) -> None:
    outside = (pixels < -0.5).any(axis=1) | (pixels[:, 0] > width_px) | (pixels[:, 1] > height_px)
    if outside.any():
        u, v = pixels[outside][0]
        raise CalibrationError(
            f"{int(outside.sum())} of {len(pixels)} pixels lie outside the image of {width_px}x{height_px} px, "
            f"e.g. ({u:.0f}, {v:.0f})",
            hint="Pixels are those of the recording's size; scale them if they were clicked in a resized picture.",
        )


def check_overlap(rig: CameraRig) -> None:
    """Refuse a rig whose views do not hang together on the ground. One camera alone is fine.

    Raises:
        NoOverlap: naming the first camera that no chain of overlapping views joins to the reference camera.
    """
    ground = {camera_id: visible_ground(camera) for camera_id, camera in rig.items()}
    joined, waiting = [rig.reference_id], [camera_id for camera_id in rig if camera_id != rig.reference_id]
    while waiting:
        found = next((c for c in waiting if any(_share_ground(rig, ground, c, other) for other in joined)), None)
        if found is None:
            raise NoOverlap(
                f"camera {waiting[0]} sees no ground that another camera sees",
                hint="At least two cameras must see the same ground; check that all calibrations use one world frame.",
                camera=waiting[0],
            )
        waiting.remove(found)
        joined.append(found)


def _share_ground(rig: CameraRig, ground: Mapping[str, Array], one: str, other: str) -> bool:
    return _sees_any(rig[other], ground[one]) or _sees_any(rig[one], ground[other])


def _sees_any(camera: Camera, ground: Array) -> bool:
    pixels, _ = camera.project(ground)
    near = np.linalg.norm(ground - camera.centre_m, axis=1) <= GROUND_RANGE_M
    return bool((camera.contains(pixels) & near).any())
