"""The image-to-ground homography from ground points, and the camera behind it.

The homography is linear least squares on normalised points (direct linear transform; Hartley & Zisserman,
Multiple View Geometry, 2nd ed., algorithm 4.2). Focal length and pose follow from it when pixels are square and the
principal point is the image's centre (ibid., section 8.8). Of real cameras it lies off by a few hundredths of the
width; it may therefore move, against resistance, where the points gain by it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from wibam_core.calibration.pnp import moved, near_origin
from wibam_core.calibration.points import check_points
from wibam_core.calibration.robust import find_inliers
from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3

Array = NDArray[np.float64]

#: The homography is undetermined when its two smallest singular values differ by less than this factor.
_DEGENERATE = 3.0
_DEGENERATE_ABSOLUTE = 1e-6
#: Focal lengths beyond these multiples of the image's width are no traffic camera's.
_FOCAL_RANGE = (0.2, 30.0)
#: Standard deviation of the principal point about the middle of the image, as a share of its width.
PRINCIPAL_POINT_SD = 0.02
#: One such deviation counts as much as one point that is off by this: the plane, the lens and the points are not exact.
PRINCIPAL_POINT_COST_PX = 3.0


@dataclass(frozen=True, eq=False)
class GroundFit:
    """A camera solved from ground points.

    Attributes:
        camera: with square pixels, a principal point near the middle and no distortion.
        used: (N,) which points it rests on; the others contradict it.
    """

    camera: Camera
    used: NDArray[np.bool_]


def solve_ground_camera(ground: Array, pixels: Array, width_px: int, height_px: int) -> GroundFit:
    """Camera from points on the ground, wherever its origin is.

    Args:
        ground: (N, 2) x, y in m at z = 0.
        pixels: (N, 2) where the camera sees them.
        width_px: image width.
        height_px: image height.

    Raises:
        CalibrationError: too few or degenerate points, a mirrored ground, or a view from which the focal length does
            not follow (straight down).
    """
    check_points(ground, pixels)
    origin = near_origin(ground)
    ground = ground - origin[:2]

    def from_points(index: NDArray[np.int64]) -> list[Array]:
        try:
            return [fit_homography(ground[index], pixels[index])]
        except CalibrationError:
            return []

    used = find_inliers(
        len(ground), 4, from_points, lambda H: np.linalg.norm(apply_homography(H, ground) - pixels, axis=1)
    )
    H = fit_homography(ground[used], pixels[used])
    start = camera_from_homography(H, ground[used].mean(axis=0), width_px, height_px)
    local = _polish(start, ground[used], pixels[used])
    return GroundFit(replace(local, T_world_cam=moved(local.T_world_cam, origin)), used)


def fit_homography(source: Array, target: Array) -> Array:
    """(3, 3) homography from points (N, 2) to points (N, 2) by linear least squares, of unit Frobenius norm.

    It is scaled so that the source points get a positive third coordinate.

    Raises:
        CalibrationError: fewer than four points, degenerate ones, or ones that no single view shows (they fall on
            both sides of the horizon).
    """
    if len(source) < 4:
        raise CalibrationError(f"{len(source)} ground points are too few; at least 4 are needed")
    T_source, T_target = _normaliser(source), _normaliser(target)
    s, t = apply_homography(T_source, source), apply_homography(T_target, target)
    zeros, ones = np.zeros(len(s)), np.ones(len(s))
    x, y, u, v = s[:, 0], s[:, 1], t[:, 0], t[:, 1]
    A = np.concatenate(
        [
            np.stack([x, y, ones, zeros, zeros, zeros, -u * x, -u * y, -u], axis=1),
            np.stack([zeros, zeros, zeros, x, y, ones, -v * x, -v * y, -v], axis=1),
        ]
    )
    _, values, vt = np.linalg.svd(A, full_matrices=True)
    second, smallest = float(values[7]), float(values[8]) if len(values) > 8 else 0.0
    if second < _DEGENERATE_ABSOLUTE * values[0] or second < _DEGENERATE * smallest:
        raise CalibrationError(
            "the ground points do not fix a homography",
            hint="Too many of them lie on one line, or pixels and world points are paired wrongly.",
        )
    H = np.linalg.inv(T_target) @ vt[8].reshape(3, 3) @ T_source
    H /= np.linalg.norm(H)
    third = np.concatenate([source, ones[:, None]], axis=1) @ H[2]
    if third.mean() < 0:
        H, third = -H, -third
    if (third <= 0).any():
        raise CalibrationError(
            "no single view shows all ground points: they fall on both sides of the horizon",
            hint="Check that each pixel belongs to its world point.",
        )
    return np.asarray(H)


def apply_homography(H: Array, points: Array) -> Array:
    """Map points (N, 2) by a homography (3, 3)."""
    mapped = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _normaliser(points: Array) -> Array:
    """(3, 3) similarity that brings points (N, 2) to mean 0 and mean distance √2."""
    mean = points.mean(axis=0)
    scale = np.sqrt(2.0) / max(float(np.linalg.norm(points - mean, axis=1).mean()), 1e-12)
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]])


def camera_from_homography(H_image_ground: Array, visible: Array, width_px: int, height_px: int) -> Camera:
    """The camera whose ground homography comes closest to the given one.

    Args:
        H_image_ground: (3, 3), from (x, y, 1) in m to pixels.
        visible: (2,) a ground point that the camera sees, m; it tells front from back.
        width_px: image width.
        height_px: image height.

    Raises:
        CalibrationError: if the focal length does not follow, or the ground is mirrored.
    """
    centre = np.array([[1, 0, (width_px - 1) / 2], [0, 1, (height_px - 1) / 2], [0, 0, 1]])
    H = np.linalg.inv(centre) @ H_image_ground
    # Columns h1, h2 of K⁻¹H are orthogonal and of equal length; both are linear in s = 1 / f².
    unit = np.diag([1 / width_px, 1 / width_px, 1.0]) @ H
    h1, h2 = unit[:, 0], unit[:, 1]
    slopes = np.array([h1[:2] @ h2[:2], h1[:2] @ h1[:2] - h2[:2] @ h2[:2]])
    levels = np.array([h1[2] * h2[2], h1[2] ** 2 - h2[2] ** 2])
    s = -float(slopes @ levels) / max(float(slopes @ slopes), 1e-300)
    limits = [f**-2 for f in _FOCAL_RANGE]
    if not limits[1] <= s <= limits[0]:
        raise CalibrationError(
            "the focal length does not follow from the ground points",
            hint="Spread them over more depth, or give the intrinsics and use calibration kind 'pnp'.",
        )
    focal = width_px / np.sqrt(s)
    M = np.diag([1 / focal, 1 / focal, 1.0]) @ H
    M /= np.sqrt(np.linalg.norm(M[:, 0]) * np.linalg.norm(M[:, 1]))
    if M[2] @ np.array([visible[0], visible[1], 1.0]) < 0:
        M = -M
    u, _, vt = np.linalg.svd(np.stack([M[:, 0], M[:, 1], np.cross(M[:, 0], M[:, 1])], axis=1))
    T_world_cam = SE3(u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt, M[:, 2]).inverse()
    if T_world_cam.translation[2] <= 0:
        raise CalibrationError(
            "the ground looks mirrored: the points fit a camera below it",
            hint="World axes must be right-handed with Z up: swap X and Y, or flip the sign of one of them. "
            "Longitude and latitude that were exchanged look the same.",
        )
    K = centre @ np.diag([focal, focal, 1.0])
    return Camera(K, np.zeros(0), T_world_cam, width_px, height_px)


def _polish(camera: Camera, ground: Array, pixels: Array) -> Camera:
    """The camera with the smallest reprojection error and cost of its principal point."""
    world = np.concatenate([ground, np.zeros((len(ground), 1))], axis=1)
    centre = world.mean(axis=0)
    sd_px = PRINCIPAL_POINT_SD * camera.width_px

    def rebuild(x: Array) -> Camera:
        K = np.array(camera.K)
        K[0, 0] = K[1, 1] = camera.K[0, 0] * np.exp(x[0])
        K[:2, 2] += sd_px * x[7:9]
        turn = SE3.from_rvec_tvec(x[1:4], np.zeros(3))
        at_centre = SE3(np.eye(3), centre)
        pose = at_centre @ turn @ at_centre.inverse() @ camera.T_world_cam
        pose = SE3(pose.rotation, centre + (pose.translation - centre) * np.exp(x[6]) + [x[4], x[5], 0.0])
        return Camera(K, np.zeros(0), pose, camera.width_px, camera.height_px)

    def residuals(x: Array) -> Array:
        projected, _ = rebuild(x).project(world)
        errors_px = np.nan_to_num(projected - pixels, nan=1e4).reshape(-1)
        return np.concatenate([errors_px, PRINCIPAL_POINT_COST_PX * x[7:9]])

    solution = least_squares(residuals, np.zeros(9), method="trf", x_scale="jac", max_nfev=200)
    polished = rebuild(solution.x)
    return polished if polished.centre_m[2] > 0 else camera
