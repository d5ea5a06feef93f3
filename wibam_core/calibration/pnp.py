"""Pose from surveyed points and known intrinsics: perspective-n-point.

SQPnP (Terzakis & Lourakis, ECCV 2020) for the start, Levenberg-Marquardt on the reprojection error for the end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.calibration.points import MIN_POINTS, check_points
from wibam_core.calibration.robust import find_inliers
from wibam_core.errors import CalibrationError
from wibam_core.geometry.se3 import SE3

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PoseFit:
    """A solved pose.

    Attributes:
        T_world_cam: the camera's pose.
        errors_px: (N,) reprojection error of every point.
        used: (N,) which points the pose rests on; the others contradict them.
    """

    T_world_cam: SE3
    errors_px: Array
    used: NDArray[np.bool_]


def solve_pose(world: Array, pixels: Array, K: Array, dist: Array) -> PoseFit:
    """The pose of a camera with known intrinsics, wherever the world's origin is.

    Args:
        world: (N, 3) surveyed points, m.
        pixels: (N, 2) where the camera sees them.
        K: (3, 3).
        dist: (n,) in OpenCV order.

    Raises:
        CalibrationError: too few points, points on one line, or points behind the camera.
    """
    check_points(world, pixels)
    K, dist = np.array(K, dtype=np.float64), np.array(dist, dtype=np.float64)
    origin = near_origin(world)
    world = world - origin
    fit = _fit(world, pixels, K, dist)
    if fit is None:
        raise CalibrationError("no pose has all points in front of the camera", hint=_CHECK_HINT)
    return replace(fit, T_world_cam=moved(fit.T_world_cam, origin))


_CHECK_HINT = "Check that each pixel belongs to its world point, and that pixels are those of the recording's size."


def near_origin(points: Array) -> Array:
    """(3,) a place at z = 0 amid points (N, 2 or 3), to count their coordinates from while they are worked with.

    Coordinates of a map grid are millions of metres, and their products would leave no digits for the metres between
    the points. The place is the median, which one mistyped coordinate cannot carry away.
    """
    return np.append(np.median(points[:, :2], axis=0), 0.0)


def moved(T_world_cam: SE3, origin: Array) -> SE3:
    """A pose that was solved in coordinates counted from ``origin`` (3,), in the user's own."""
    return SE3(T_world_cam.rotation, T_world_cam.translation + origin)


def _fit(world: Array, pixels: Array, K: Array, dist: Array) -> PoseFit | None:
    """The best pose that has its points in front of it; above the ground where there is a choice."""

    def errors_px(pose: SE3) -> Array:
        return _errors_px(pose, world, pixels, K, dist)

    def from_points(index: NDArray[np.int64] | NDArray[np.bool_]) -> list[SE3]:
        return _candidates(world[index], pixels[index], K, dist)

    used = find_inliers(len(world), MIN_POINTS, from_points, errors_px)
    best: PoseFit | None = None
    for _ in range(3):
        options = [_polish(pose, world[used], pixels[used], K, dist) for pose in from_points(used)]
        fits = [PoseFit(pose.inverse(), errors_px(pose), used) for pose in options]
        fits = [fit for fit in fits if np.isfinite(fit.errors_px[used]).all()]
        if not fits:
            break
        best = min(fits, key=lambda fit: (fit.T_world_cam.translation[2] <= 0 and _rms(fit) > 0.5, _rms(fit)))
        limit = max(3.0, 4.0 * _rms(best))
        again = used | (best.errors_px <= limit)
        if (again == used).all():
            break
        used = again
    return best


def _candidates(world: Array, pixels: Array, K: Array, dist: Array) -> list[SE3]:
    """Poses T_cam_world by SQPnP; several where points are coplanar; none where they are degenerate."""
    try:
        count, rvecs, tvecs, _ = cv2.solvePnPGeneric(
            np.ascontiguousarray(world), np.ascontiguousarray(pixels), K, dist, flags=cv2.SOLVEPNP_SQPNP
        )
    except cv2.error:
        return []
    solutions = zip(rvecs[:count], tvecs[:count], strict=True)
    return [SE3.from_rvec_tvec(r, t) for r, t in solutions if np.isfinite(r).all() and np.isfinite(t).all()]


def _polish(pose: SE3, world: Array, pixels: Array, K: Array, dist: Array) -> SE3:
    rvec, tvec = pose.to_rvec_tvec()
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    rvec, tvec = cv2.solvePnPRefineLM(
        np.ascontiguousarray(world), np.ascontiguousarray(pixels), K, dist, rvec[:, None], tvec[:, None], stop
    )
    return SE3.from_rvec_tvec(rvec, tvec) if np.isfinite(rvec).all() and np.isfinite(tvec).all() else pose


def _errors_px(T_cam_world: SE3, world: Array, pixels: Array, K: Array, dist: Array) -> Array:
    """(N,) reprojection errors; infinite for points behind the camera."""
    rvec, tvec = T_cam_world.to_rvec_tvec()
    projected, _ = cv2.projectPoints(np.ascontiguousarray(world), rvec, tvec, K, dist)
    errors = np.linalg.norm(projected.reshape(-1, 2) - pixels, axis=1)
    return np.where(T_cam_world.apply(world)[:, 2] > 0, errors, np.inf)


def _rms(fit: PoseFit) -> float:
    return float(np.sqrt((fit.errors_px[fit.used] ** 2).mean()))
