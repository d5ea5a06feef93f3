"""How well points fix the camera that was solved from them.

To first order around the solution the unknowns have the covariance σ² (JᵀJ)⁻¹, where J has the derivatives of the
projected points by the unknowns (Hartley & Zisserman, Multiple View Geometry, 2nd ed., section 5.2). The variance σ² of
the clicks is estimated from the residuals, by ν numbers more than there are unknowns; for that reason the errors follow
Student's t distribution with ν degrees of freedom, whose variance is ν / (ν − 2) times as large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.camera import Camera

Array = NDArray[np.float64]

#: Step of the numerical derivatives, of a point one unit in front of the camera: half of the digits of a double.
_STEP = 1e-7


@dataclass(frozen=True, eq=False)
class CameraCovariance:
    """The covariance of a solved camera.

    Attributes:
        matrix: (6, 6), or (7, 7) where the focal length was solved, too: of the rotation (rad, about the camera's x, y
            and z axes), the position (m, along the world's) and the logarithm of the focal length.
        focal_px: the focal length; None where it was given.
    """

    matrix: Array
    focal_px: float | None

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
        return None if self.focal_px is None else float(self.focal_px * np.sqrt(self.matrix[6, 6]))


def camera_covariance(camera: Camera, world: Array, pixels: Array, *, solved_focal: bool) -> CameraCovariance | None:
    """The covariance of a camera that was solved from points by least squares.

    Args:
        camera: the solution.
        world: (N, 3) the points that it rests on, m; all in front of it.
        pixels: (N, 2) where they were seen.
        solved_focal: the focal length was solved with the pose.

    Returns:
        None where there are too few points to tell: the numbers seen are to be three more than the unknowns at least.
    """
    unknowns = 7 if solved_focal else 6
    freedom = pixels.size - unknowns
    if freedom <= 2:
        return None
    jacobian = _jacobian(camera, world)[:, :unknowns]
    squares = float(((camera.project(world)[0] - pixels) ** 2).sum())
    _, values, axes = np.linalg.svd(jacobian, full_matrices=False)
    matrix = (axes.T / values**2) @ axes * squares / (freedom - 2)
    return CameraCovariance(matrix, float(camera.K[0, 0]) if solved_focal else None)


def _jacobian(camera: Camera, world: Array) -> Array:
    """(2N, 7) derivatives of the pixels of points (N, 3) by rotation, position and log focal length."""
    cam = camera.to_camera(world)
    by_cam = np.empty((len(cam), 2, 3))
    for axis in range(3):
        step = _STEP * cam[:, 2:3] * np.eye(3)[axis]
        ahead, behind = camera.project_camera_points(cam + step), camera.project_camera_points(cam - step)
        by_cam[:, :, axis] = (ahead - behind) / (2 * _STEP * cam[:, 2:3])
    x, y, z = cam.T
    zero = np.zeros(len(cam))
    # turning the camera by w moves a point by −w × p, which is [p]× w
    cross = np.stack([np.stack(row, axis=1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=1)
    by_rotation = by_cam @ cross
    by_position = -by_cam @ camera.T_cam_world.rotation
    by_log_focal = (camera.project_camera_points(cam) - camera.K[:2, 2])[:, :, None]
    return np.concatenate([by_rotation, by_position, by_log_focal], axis=2).reshape(-1, 7)
