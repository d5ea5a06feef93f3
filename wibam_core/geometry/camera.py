"""Cameras: pinholes with OpenCV's distortion, fisheyes and omnidirectional ones.

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
from wibam_core.geometry.wide import Fisheye, Omnidirectional, WideLens, angles_rad
from wibam_core.site import Lens

Array = NDArray[np.float64]

#: How many coefficients ``dist`` may have.
_COEFFICIENTS: dict[Lens, tuple[int, ...]] = {
    "pinhole": (0, 4, 5, 8, 12, 14),
    "fisheye": (0, 4),
    "omnidirectional": (0, 4),
}


@dataclass(frozen=True, eq=False)
class Camera:
    """One calibrated camera.

    Attributes:
        K: (3, 3) intrinsic matrix, px.
        dist: (n,) distortion coefficients of the lens. Of a pinhole in OpenCV order (k1, k2, p1, p2, k3, ...), n in
            0, 4, 5, 8, 12, 14; the 13th and 14th, a tilted sensor's, must be zero. Of a fisheye k1, k2, k3, k4, of an
            omnidirectional lens k1, k2, p1, p2, or none; see `wibam_core.geometry.wide`.
        T_world_cam: pose; ``x_world = T_world_cam.apply(x_cam)``.
        width_px, height_px: image size.
        lens: "pinhole", "fisheye" or "omnidirectional". The latter two are *wide*: they may see what lies beside or
            behind them, and no pixel of theirs is known by x/z and y/z alone.
        xi: of an omnidirectional lens; 0 for the others.
        distortion_limit: undistorted radius (tan of the angle to the axis) beyond which a pinhole's distortion goes on
            in straight lines, see `wibam_core.geometry.distortion`; infinite without distortion.
    """

    K: Array
    dist: Array
    T_world_cam: SE3
    width_px: int
    height_px: int
    lens: Lens = "pinhole"
    xi: float = 0.0
    distortion_limit: float = field(init=False, repr=False, default=np.inf)

    def __post_init__(self) -> None:
        K = np.array(self.K, dtype=np.float64)
        dist = np.array(self.dist, dtype=np.float64).reshape(-1)
        if K.shape != (3, 3) or not np.isfinite(K).all():
            raise ValueError("K must be a finite 3x3 matrix")
        if K[0, 0] <= 0 or K[1, 1] <= 0 or not np.allclose(K[2], [0, 0, 1]):
            raise ValueError("K must have positive focal lengths and a last row of 0 0 1")
        allowed = _COEFFICIENTS[self.lens]
        if dist.size not in allowed or not np.isfinite(dist).all():
            some = f"{', '.join(map(str, allowed[:-1]))} or {allowed[-1]}"
            raise ValueError(f"dist must hold {some} finite coefficients, got {dist.size}")
        if dist[12:].any():
            raise ValueError("the lens has a tilted sensor (coefficients 13 and 14), which is not supported")
        if self.width_px <= 0 or self.height_px <= 0:
            raise ValueError("image size must be positive")
        if not (np.isfinite(self.xi) and self.xi >= 0) or (self.xi and self.lens != "omnidirectional"):
            raise ValueError("xi belongs to an omnidirectional lens, and is not negative")
        K.setflags(write=False)
        dist.setflags(write=False)
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "dist", dist)
        if not self.is_wide and self.has_distortion:
            monotone = distortion.monotone_radius(self._coefficients)
            border = distortion.undistort(self._coefficients, self._normalised(self._border_px()), monotone)
            radius = float(np.linalg.norm(border, axis=-1).max())
            object.__setattr__(self, "distortion_limit", min(monotone, distortion.TRUSTED_SHARE * radius))

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
    def is_wide(self) -> bool:
        """Whether the lens is no pinhole."""
        return self.lens != "pinhole"

    @property
    def has_distortion(self) -> bool:
        """Whether straight lines may look bent."""
        return self.is_wide or bool(self.dist.size and np.any(self.dist != 0))

    @cached_property
    def wide_lens(self) -> WideLens:
        """How a wide lens maps directions; there is none of a pinhole."""
        assert self.is_wide, "a pinhole maps points of a plane"
        k1, k2, k3, k4 = (self.dist.tolist() + [0.0] * 4)[:4]
        if self.lens == "fisheye":
            return Fisheye((k1, k2, k3, k4))
        border = tuple((x, y) for x, y in self._normalised(self._border_px()).tolist())
        return Omnidirectional(self.xi, (k1, k2, k3, k4), border)

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
        """(3, 4) projection matrix ``K [R|t]`` of a pinhole (without distortion)."""
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
        """Camera-frame points (..., 3) to pixels (..., 2); `sees` must say that they are in front of the camera."""
        points = np.asarray(points_cam, dtype=np.float64)
        xy = self.wide_lens.to_plane(points) if self.is_wide else points[..., :2] / points[..., 2:3]
        if not self.is_wide and self.has_distortion:
            xy = distortion.distort(self._coefficients, xy, self.distortion_limit)
        return xy * np.array([self.K[0, 0], self.K[1, 1]]) + np.stack(
            [self.K[0, 1] * xy[..., 1] + self.K[0, 2], np.full(xy.shape[:-1], self.K[1, 2])], axis=-1
        )

    def sees(self, points_cam: Array) -> NDArray[np.bool_]:
        """Which camera-frame points (..., 3) are in front of the camera, be it beyond the border of its image."""
        if self.is_wide:
            return np.asarray(angles_rad(points_cam) <= self.wide_lens.limit_rad)
        return np.asarray(points_cam[..., 2] > 0)

    def project(self, points_world: ArrayLike) -> tuple[Array, Array]:
        """Project world points (..., 3).

        Returns:
            pixels (..., 2), NaN for points not in front of the camera, and depths along the optical axis (...,) in m.
        """
        cam = self.to_camera(points_world)
        depth = cam[..., 2]
        behind = ~self.sees(cam)
        safe = np.where(behind[..., None], 1.0, cam)
        uv = self.project_camera_points(safe)
        return np.where(behind[..., None], np.nan, uv), depth

    # --- image -> world ---------------------------------------------------------------------
    def undistort(self, uv: ArrayLike) -> Array:
        """Pixels (..., 2) to normalised image coordinates (..., 2) of the ideal pinhole (x/z, y/z).

        NaN where a wide lens sees what lies beside or behind it.
        """
        xy = self._normalised(np.asarray(uv, dtype=np.float64))
        if self.is_wide:
            directions = self.wide_lens.to_directions(xy)
            with np.errstate(divide="ignore", invalid="ignore"):
                ahead = directions[..., 2:] > 0
                return np.where(ahead, directions[..., :2] / directions[..., 2:], np.nan)
        return distortion.undistort(self._coefficients, xy, self.distortion_limit) if self.has_distortion else xy

    def _normalised(self, pixels: Array) -> Array:
        """Pixels (..., 2) in normalised coordinates (..., 2), still distorted: points of the lens plane."""
        y = (pixels[..., 1] - self.K[1, 2]) / self.K[1, 1]
        x = (pixels[..., 0] - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0]
        return np.stack([x, y], axis=-1)

    def rays(self, uv: ArrayLike) -> Array:
        """Unit directions in the world (..., 3) of the rays through pixels (..., 2), from ``centre_m``.

        NaN where a wide lens shows nothing.
        """
        if self.is_wide:
            plane = self._normalised(np.asarray(uv, dtype=np.float64))
            return np.asarray(self.T_world_cam.rotate(self.wide_lens.to_directions(plane)))
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
        K = resized_intrinsics(self.K, scale)
        return Camera(K, self.dist, self.T_world_cam, width_px, height_px, self.lens, self.xi)
