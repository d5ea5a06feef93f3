"""Pose from surveyed points and known intrinsics: perspective-n-point.

SQPnP (Terzakis & Lourakis, ECCV 2020) for the start, Levenberg-Marquardt on the reprojection error for the end. OpenCV
does both for pinholes. A wide lens starts from the directions of its rays, turned so that a pinhole would see them, and
ends on the reprojection error in its own pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from wibam_core.calibration.points import MIN_POINTS, check_points
from wibam_core.calibration.robust import find_inliers
from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3

Array = NDArray[np.float64]

#: A wide lens's points serve to begin with where a pinhole that looks amid them would see them: this is the cosine of
#: the widest angle to its axis. Rays all around have no middle; this is the length of the shortest mean of unit rays.
_AHEAD = 0.1
_SMALLEST_MEAN = 0.05


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
    K = np.array(K, dtype=np.float64)
    if K[0, 1]:  # OpenCV knows no skew: pixels are put where they would be without one
        pixels = pixels - np.outer((pixels[:, 1] - K[1, 2]) / K[1, 1], [K[0, 1], 0.0])
        K[0, 1] = 0.0
    return _solve(world, pixels, _Pinhole(K, np.array(dist, dtype=np.float64)))


def solve_wide_pose(world: Array, pixels: Array, lens: Camera) -> PoseFit:
    """`solve_pose` of a camera with a wide lens.

    Args:
        world: (N, 3) surveyed points, m.
        pixels: (N, 2) where the camera sees them.
        lens: its intrinsics; the pose is of no account.

    Raises:
        CalibrationError: as of `solve_pose`, or pixels where the lens shows nothing.
    """
    return _solve(world, pixels, _Wide(replace(lens, T_world_cam=SE3.identity())))


def _solve(world: Array, pixels: Array, lens: _Lens) -> PoseFit:
    check_points(world, pixels)
    origin = near_origin(world)
    world = world - origin
    fit = _fit(world, pixels, lens)
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


class _Lens(Protocol):
    """How poses ``T_cam_world`` follow from points (N, 3) that are seen at pixels (N, 2)."""

    def candidates(self, world: Array, pixels: Array) -> list[SE3]:
        """Poses by SQPnP; several where points are coplanar; none where they are degenerate."""

    def polished(self, pose: SE3, world: Array, pixels: Array) -> SE3:
        """The pose near the given one with the smallest reprojection error."""

    def errors_px(self, pose: SE3, world: Array, pixels: Array) -> Array:
        """(N,) reprojection errors; infinite for points that are not in front of the camera."""


def _fit(world: Array, pixels: Array, lens: _Lens) -> PoseFit | None:
    """The best pose that has its points in front of it; above the ground where there is a choice."""

    def errors_px(pose: SE3) -> Array:
        return lens.errors_px(pose, world, pixels)

    def from_points(index: NDArray[np.int64] | NDArray[np.bool_]) -> list[SE3]:
        return lens.candidates(world[index], pixels[index])

    used = find_inliers(len(world), MIN_POINTS, from_points, errors_px)
    best: PoseFit | None = None
    for _ in range(3):
        options = [lens.polished(pose, world[used], pixels[used]) for pose in from_points(used)]
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


@dataclass(frozen=True, eq=False)
class _Pinhole:
    """OpenCV's pinhole: K (3, 3), and dist (n,) in OpenCV order."""

    K: Array
    dist: Array

    def candidates(self, world: Array, pixels: Array) -> list[SE3]:
        return sqpnp(world, pixels, self.K, self.dist)

    def polished(self, pose: SE3, world: Array, pixels: Array) -> SE3:
        rvec, tvec = pose.to_rvec_tvec()
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
        points, seen = np.ascontiguousarray(world), np.ascontiguousarray(pixels)
        rvec, tvec = cv2.solvePnPRefineLM(points, seen, self.K, self.dist, rvec[:, None], tvec[:, None], stop)
        return SE3.from_rvec_tvec(rvec, tvec) if np.isfinite(rvec).all() and np.isfinite(tvec).all() else pose

    def errors_px(self, pose: SE3, world: Array, pixels: Array) -> Array:
        rvec, tvec = pose.to_rvec_tvec()
        projected, _ = cv2.projectPoints(np.ascontiguousarray(world), rvec, tvec, self.K, self.dist)
        errors = np.linalg.norm(projected.reshape(-1, 2) - pixels, axis=1)
        return np.where(pose.apply(world)[:, 2] > 0, errors, np.inf)


@dataclass(frozen=True, eq=False)
class _Wide:
    """A camera with a wide lens that stands at the origin."""

    lens: Camera

    def candidates(self, world: Array, pixels: Array) -> list[SE3]:
        rays = self.lens.rays(pixels)
        towards = rays.mean(axis=0)
        if not np.isfinite(towards).all() or np.linalg.norm(towards) < _SMALLEST_MEAN:
            return []
        turn = _turned_ahead(towards / np.linalg.norm(towards))
        ahead = turn.apply(rays)
        seen = ahead[:, 2] > _AHEAD
        if seen.sum() < MIN_POINTS:
            return []
        plane = ahead[seen, :2] / ahead[seen, 2:]
        return [turn.inverse() @ pose for pose in sqpnp(world[seen], plane, np.eye(3), np.zeros(0))]

    def polished(self, pose: SE3, world: Array, pixels: Array) -> SE3:
        def moved_by(x: Array) -> SE3:
            return SE3.from_rvec_tvec(x[:3], x[3:]) @ pose

        def residuals(x: Array) -> Array:
            return np.nan_to_num(self.lens.project_camera_points(moved_by(x).apply(world)) - pixels, nan=1e4).ravel()

        return moved_by(least_squares(residuals, np.zeros(6), method="lm", x_scale="jac", max_nfev=1000).x)

    def errors_px(self, pose: SE3, world: Array, pixels: Array) -> Array:
        projected = self.lens.project_camera_points(pose.apply(world))
        return np.nan_to_num(np.linalg.norm(projected - pixels, axis=1), nan=np.inf)


def sqpnp(world: Array, pixels: Array, K: Array, dist: Array) -> list[SE3]:
    """Poses T_cam_world of a pinhole; several where points are coplanar; none where they are degenerate."""
    try:
        count, rvecs, tvecs, _ = cv2.solvePnPGeneric(
            np.ascontiguousarray(world), np.ascontiguousarray(pixels), K, dist, flags=cv2.SOLVEPNP_SQPNP
        )
    except cv2.error:
        return []
    solutions = zip(rvecs[:count], tvecs[:count], strict=True)
    return [SE3.from_rvec_tvec(r, t) for r, t in solutions if np.isfinite(r).all() and np.isfinite(t).all()]


def _turned_ahead(direction: Array) -> SE3:
    """The rotation that brings a unit direction (3,) onto the optical axis."""
    axis = np.array([0.0, 0.0, 1.0])
    side = np.cross(direction, axis)
    sine, angle = np.linalg.norm(side), np.arctan2(np.linalg.norm(side), direction[2])
    around = side / sine if sine > 0 else np.array([1.0, 0.0, 0.0])
    return SE3.from_rvec_tvec(around * angle, np.zeros(3))


def _rms(fit: PoseFit) -> float:
    return float(np.sqrt((fit.errors_px[fit.used] ** 2).mean()))
