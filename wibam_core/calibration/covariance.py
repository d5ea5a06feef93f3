"""How well points fix the camera that was solved from them.

To first order around the solution the unknowns have the covariance σ² (JᵀJ)⁻¹, where J has the derivatives of the
projected points by the unknowns (Hartley & Zisserman, Multiple View Geometry, 2nd ed., section 5.2). The variance σ² of
the clicks is estimated from the residuals, by ν numbers more than there are unknowns; for that reason the errors follow
Student's t distribution with ν degrees of freedom, whose variance is ν / (ν − 2) times as large.

Where the focal length was solved, too, so was the principal point, against a cost Λ of leaving the middle, and with
points above the road k1, against one of leaving 0. With A = JᵀJ + Λ the errors then have two sources, clicks and what
is truly away from the middle and from 0, and the covariance is A⁻¹ (σ² JᵀJ + c² Λ) A⁻¹, where c is what one standard
deviation of these costs (`wibam_core.calibration.homography`, `wibam_core.calibration.unknown_lens`). Rotation and
principal point then hardly tell from each other, but make up for each other on the ground, so that the ground is what
to judge a camera by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.calibration.homography import PRINCIPAL_POINT_COST_PX, PRINCIPAL_POINT_SD
from wibam_core.calibration.unknown_lens import K1_COST_PX, K1_SD
from wibam_core.geometry.camera import Camera

Array = NDArray[np.float64]

#: Step of the numerical derivatives, of a point one unit in front of the camera: half of the digits of a double.
_STEP = 1e-7


@dataclass(frozen=True, eq=False)
class CameraCovariance:
    """The covariance of a solved camera.

    Attributes:
        matrix: (6, 6), or (9, 9) where the focal length was solved, too, or (10, 10) with k1: of the rotation (rad,
            about the camera's x, y and z axes), the position (m, along the world's), the logarithm of the focal length,
            the principal point (px) and k1.
        camera: the solution.
    """

    matrix: Array
    camera: Camera

    @property
    def rotation_sd_deg(self) -> list[float]:
        """Standard deviations of the rotation about the camera's x, y and z axes."""
        return np.degrees(np.sqrt(np.diagonal(self.matrix)[:3])).tolist()

    @property
    def position_sd_m(self) -> list[float]:
        """Standard deviations of the position along the world's axes."""
        return np.sqrt(np.diagonal(self.matrix)[3:6]).tolist()

    @property
    def focal_sd_px(self) -> float | None:
        """Standard deviation of the focal length; None where it was given."""
        return float(self.camera.K[0, 0] * np.sqrt(self.matrix[6, 6])) if len(self.matrix) > 6 else None

    @property
    def k1_sd(self) -> float | None:
        """Standard deviation of the first distortion coefficient; None where it was given."""
        return float(np.sqrt(self.matrix[9, 9])) if len(self.matrix) > 9 else None

    def ground_sd_m(self, ground: Array) -> Array:
        """(N,) standard deviations of where the pixels of ground points (N, 3) meet the ground, both axes together."""
        return np.asarray(np.sqrt(np.trace(self.ground_covariances(ground), axis1=1, axis2=2)))

    def ground_covariances(self, ground: Array) -> Array:
        """(N, 2, 2) covariances of where the pixels of points (N, 3) meet the level planes that these lie in, m²."""
        moves = ground_moves(self.camera, ground, len(self.matrix))
        return np.asarray(np.einsum("nij,jk,nlk->nil", moves, self.matrix, moves))


def ground_moves(camera: Camera, ground: Array, unknowns: int = 6) -> Array:
    """(N, 2, unknowns) by how much the places where the pixels of points (N, 3) meet the level planes that these lie in
    move with the unknowns of `CameraCovariance.matrix`."""
    jacobian = _jacobian(camera, ground).reshape(len(ground), 2, 10)[:, :, :unknowns]
    return np.asarray(np.linalg.solve(-jacobian[:, :, 3:5], jacobian))


def camera_covariance(
    camera: Camera,
    world: Array,
    pixels: Array,
    *,
    solved_focal: bool,
    solved_k1: bool = False,
    least_click_px: float = 0.0,
) -> CameraCovariance | None:
    """The covariance of a camera that was solved from points by least squares.

    Args:
        camera: the solution.
        world: (N, 3) the points that it rests on, m; all in front of it.
        pixels: (N, 2) where they were seen.
        solved_focal: the focal length was solved with the pose, and the principal point as far as points on the ground
            tell it.
        solved_k1: k1 was solved with these.
        least_click_px: clicks are not believed to be better than this, whatever the residuals say.

    Returns:
        None where there are too few points to tell: the numbers seen are to be three more than the unknowns at least.
    """
    freedom = pixels.size - (8 if solved_k1 else 7 if solved_focal else 6)
    if freedom <= 2:
        return None
    squares = float(((camera.project(world)[0] - pixels) ** 2).sum())
    variance_px2 = max(squares / (freedom - 2), least_click_px**2)
    jacobian = _jacobian(camera, world)
    if not solved_focal:
        _, values, axes = np.linalg.svd(jacobian[:, :6], full_matrices=False)
        return CameraCovariance((axes.T / values**2) @ axes * variance_px2, camera)
    known = 3 if solved_k1 else 2
    costs = np.array([PRINCIPAL_POINT_COST_PX, PRINCIPAL_POINT_COST_PX, K1_COST_PX])[:known]
    sd = np.array([PRINCIPAL_POINT_SD * camera.width_px, PRINCIPAL_POINT_SD * camera.width_px, K1_SD])[:known]
    held = np.zeros((known, 7 + known))
    held[:, 7:] = np.diag(costs / sd)
    solved = np.linalg.pinv(np.concatenate([jacobian[:, : 7 + known], held]))  # A⁻¹ (Jᵀ, √Λ)
    by_clicks, by_known = solved[:, :-known], solved[:, -known:] * costs
    matrix = variance_px2 * by_clicks @ by_clicks.T + by_known @ by_known.T
    return CameraCovariance(matrix, camera)


def _jacobian(camera: Camera, world: Array) -> Array:
    """(2N, 10) derivatives of the pixels of points (N, 3) by rotation, position, log focal length, principal point, k1
    (of a pinhole)."""
    cam = camera.to_camera(world)
    away = np.linalg.norm(cam, axis=1, keepdims=True) if camera.is_wide else cam[:, 2:3]
    by_cam = np.empty((len(cam), 2, 3))
    for axis in range(3):
        step = _STEP * away * np.eye(3)[axis]
        ahead, behind = camera.project_camera_points(cam + step), camera.project_camera_points(cam - step)
        by_cam[:, :, axis] = (ahead - behind) / (2 * _STEP * away)
    x, y, z = cam.T
    zero = np.zeros(len(cam))
    # turning the camera by w moves a point by −w × p, which is [p]× w
    cross = np.stack([np.stack(row, axis=1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=1)
    by_rotation = by_cam @ cross
    by_position = -by_cam @ camera.T_cam_world.rotation
    by_log_focal = (camera.project_camera_points(cam) - camera.K[:2, 2])[:, :, None]
    by_middle = np.tile(np.eye(2), (len(cam), 1, 1))
    plane = cam[:, :2] / away
    by_k1 = (np.diagonal(camera.K)[:2] * plane * (plane**2).sum(axis=1, keepdims=True))[:, :, None]
    return np.concatenate([by_rotation, by_position, by_log_focal, by_middle, by_k1], axis=2).reshape(-1, 10)
