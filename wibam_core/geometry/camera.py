"""Pinhole cameras with OpenCV distortion.

Camera frame: x right, y down, z forward. Pixel (0, 0) is the centre of the top-left pixel, so an image
covers u in [−0.5, width − 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.geometry import distortion
from wibam_core.geometry.pixels import resized_intrinsics, scale_of
from wibam_core.geometry.se3 import SE3

Array = NDArray[np.float64]

#: Points farther out than this multiple of the image corner are not distorted any further: the coefficients were
#: measured within the image, and a polynomial is anyone's guess beyond what it was fitted to.
_DISTORTION_LIMIT = 1.3


@dataclass(frozen=True, eq=False)
class Camera:
    """One calibrated camera.

    Attributes:
        K: (3, 3) intrinsic matrix, px.
        dist: (n,) distortion coefficients in OpenCV order (k1, k2, p1, p2, k3, ...); n in 0, 4, 5, 8, 12, 14. The
            13th and 14th, a tilted sensor's, must be zero.
        T_world_cam: pose; ``x_world = T_world_cam.apply(x_cam)``.
        width_px, height_px: image size.
        distortion_limit: undistorted radius (tan of the angle to the axis) beyond which the distortion goes on in
            straight lines, see `wibam_core.geometry.distortion`; infinite without distortion.
    """

    K: Array
    dist: Array
    T_world_cam: SE3
    width_px: int
    height_px: int
    distortion_limit: float = field(init=False, repr=False, default=np.inf)

    def __post_init__(self) -> None:
        K = np.array(self.K, dtype=np.float64)
        dist = np.array(self.dist, dtype=np.float64).reshape(-1)
        if K.shape != (3, 3) or not np.isfinite(K).all():
            raise ValueError("K must be a finite 3x3 matrix")
        if K[0, 0] <= 0 or K[1, 1] <= 0 or not np.allclose(K[2], [0, 0, 1]):
            raise ValueError("K must have positive focal lengths and a last row of 0 0 1")
        if dist.size not in (0, 4, 5, 8, 12, 14) or not np.isfinite(dist).all():
            raise ValueError(f"dist must hold 0, 4, 5, 8, 12 or 14 finite coefficients, got {dist.size}")
        if dist[12:].any():
            raise ValueError("the lens has a tilted sensor (coefficients 13 and 14), which is not supported")
        if self.width_px <= 0 or self.height_px <= 0:
            raise ValueError("image size must be positive")
        K.setflags(write=False)
        dist.setflags(write=False)
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "dist", dist)
        if self.has_distortion:
            monotone = distortion.monotone_radius(self._coefficients)
            border = distortion.undistort(self._coefficients, self._normalised(self._border_px()), monotone)
            radius = float(np.linalg.norm(border, axis=-1).max())
            object.__setattr__(self, "distortion_limit", min(monotone, _DISTORTION_LIMIT * radius))

    def _border_px(self) -> Array:
        w, h = self.width_px - 0.5, self.height_px - 0.5
        xs, ys = np.linspace(-0.5, w, 9), np.linspace(-0.5, h, 9)
        top, left = np.full(9, -0.5), np.full(9, -0.5)
        return np.concatenate(
            [np.stack(p, -1) for p in ((xs, top), (xs, np.full(9, h)), (left, ys), (np.full(9, w), ys))]
        )

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the image."""
        return self.width_px, self.height_px

    @property
    def has_distortion(self) -> bool:
        return bool(self.dist.size and np.any(self.dist != 0))

    @cached_property
    def _coefficients(self) -> tuple[float, ...]:
        """The coefficients that `wibam_core.geometry.distortion` takes."""
        return tuple((self.dist.tolist() + [0.0] * distortion.COEFFICIENTS)[: distortion.COEFFICIENTS])

    @property
    def T_cam_world(self) -> SE3:
        """OpenCV's extrinsics; its rvec and tvec are this transform's."""
        return self.T_world_cam.inverse()

    @property
    def P(self) -> Array:
        """(3, 4) projection matrix ``K [R|t]`` (without distortion)."""
        T = self.T_cam_world
        return self.K @ np.concatenate([T.rotation, T.translation[:, None]], axis=1)

    @property
    def centre_m(self) -> Array:
        """(3,) optical centre in the world."""
        return np.array(self.T_world_cam.translation)

    # --- world -> image ---------------------------------------------------------------------
    def to_camera(self, points_world: ArrayLike) -> Array:
        """World points (..., 3) in the camera frame; z is depth along the optical axis, m."""
        return self.T_cam_world.apply(points_world)

    def project_camera_points(self, points_cam: ArrayLike) -> Array:
        """Camera-frame points (..., 3) with positive z to pixels (..., 2)."""
        points = np.asarray(points_cam, dtype=np.float64)
        xy = points[..., :2] / points[..., 2:3]
        if self.has_distortion:
            xy = distortion.distort(self._coefficients, xy, self.distortion_limit)
        return xy * np.array([self.K[0, 0], self.K[1, 1]]) + np.stack(
            [self.K[0, 1] * xy[..., 1] + self.K[0, 2], np.full(xy.shape[:-1], self.K[1, 2])], axis=-1
        )

    def project(self, points_world: ArrayLike) -> tuple[Array, Array]:
        """Project world points (..., 3).

        Returns:
            pixels (..., 2), NaN for points not in front of the camera, and depths (...,) in m.
        """
        cam = self.to_camera(points_world)
        depth = cam[..., 2]
        behind = depth <= 0
        safe = np.where(behind[..., None], 1.0, cam)
        uv = self.project_camera_points(safe)
        return np.where(behind[..., None], np.nan, uv), depth

    # --- image -> world ---------------------------------------------------------------------
    def undistort(self, uv: ArrayLike) -> Array:
        """Pixels (..., 2) to normalised image coordinates (..., 2) of the ideal pinhole (x/z, y/z)."""
        xy = self._normalised(np.asarray(uv, dtype=np.float64))
        return distortion.undistort(self._coefficients, xy, self.distortion_limit) if self.has_distortion else xy

    def _normalised(self, pixels: Array) -> Array:
        """Pixels (..., 2) in normalised coordinates (..., 2), still distorted."""
        y = (pixels[..., 1] - self.K[1, 2]) / self.K[1, 1]
        x = (pixels[..., 0] - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0]
        return np.stack([x, y], axis=-1)

    def rays(self, uv: ArrayLike) -> Array:
        """Unit directions in the world (..., 3) of the rays through pixels (..., 2), from ``centre_m``."""
        xy = self.undistort(uv)
        directions = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
        directions = self.T_world_cam.rotate(directions)
        return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))

    # --- image size -------------------------------------------------------------------------
    def contains(self, uv: ArrayLike) -> NDArray[np.bool_]:
        """Which pixels (..., 2) lie in the image; NaN does not."""
        pixels = np.asarray(uv, dtype=np.float64)
        limits = np.array([self.width_px, self.height_px]) - 0.5
        with np.errstate(invalid="ignore"):
            return np.asarray(((pixels >= -0.5) & (pixels < limits)).all(axis=-1))

    def resized(self, width_px: int, height_px: int) -> Camera:
        """The same camera for the image resized to the given size, see `wibam_core.geometry.pixels`."""
        scale = scale_of(self.size_px, (width_px, height_px))
        return Camera(resized_intrinsics(self.K, scale), self.dist, self.T_world_cam, width_px, height_px)
