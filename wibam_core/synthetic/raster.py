"""Polygons in the world to polygons in the image: near-plane clipping, projection, filling."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.camera import Camera

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Nothing nearer than this to the camera's plane is drawn, m.
NEAR_M = 0.25
#: fillConvexPoly takes fixed-point coordinates with this many fractional bits.
SHIFT = 4
_FAR_PX = 2e6


def clip_near(polygon_cam: Array) -> Array:
    """The part of a polygon (K, 3) in the camera frame with z >= `NEAR_M` (Sutherland–Hodgman); (0, 3) if none."""
    z = polygon_cam[:, 2]
    if (z >= NEAR_M).all():
        return polygon_cam
    kept: list[Array] = []
    for i in range(len(polygon_cam)):
        a, b = polygon_cam[i - 1], polygon_cam[i]
        a_in, b_in = a[2] >= NEAR_M, b[2] >= NEAR_M
        if a_in != b_in:
            kept.append(a + (b - a) * ((NEAR_M - a[2]) / (b[2] - a[2])))
        if b_in:
            kept.append(b)
    return np.array(kept).reshape(-1, 3)


def subdivide(polygon: Array, step_m: float) -> Array:
    """The same outline (K, D) with points at most ``step_m`` apart, so that a distorting lens bends it."""
    parts = []
    for i in range(len(polygon)):
        a, b = polygon[i], polygon[(i + 1) % len(polygon)]
        pieces = int(np.ceil(np.linalg.norm(b - a) / step_m)) or 1
        parts.append(a + (b - a) * (np.arange(pieces) / pieces)[:, None])
    return np.concatenate(parts)


class View:
    """A camera with what drawing needs prepared.

    Attributes:
        camera: the camera.
        eye: (3,) optical centre, world.
        rotation, translation: world to camera.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.eye = camera.centre_m
        pose = camera.T_cam_world
        self.rotation: Array = pose.rotation
        self.translation: Array = pose.translation
        self.size = (camera.width_px, camera.height_px)
        self._K: Array = camera.K
        slack = 1.3 if camera.has_distortion else 1.02
        #: x / z of the image's left and right border, with some slack
        self._sides = (
            slack * (self._K[0, 2] + 1) / self._K[0, 0],
            slack * (self.size[0] - self._K[0, 2]) / self._K[0, 0],
        )
        self._step_m = 1.5 if camera.has_distortion else np.inf

    def to_camera(self, points: Array) -> Array:
        """World points (..., 3) in the camera frame."""
        return np.asarray(points @ self.rotation.T + self.translation)

    def pixels(self, points_cam: Array) -> Array:
        """Camera-frame points (..., 3) in front of the camera to pixels (..., 2), bounded for the rasteriser."""
        if self.camera.has_distortion:
            return np.clip(self.camera.project_camera_points(points_cam), -_FAR_PX, _FAR_PX)
        image = points_cam @ self._K.T
        return np.asarray((image[..., :2] / image[..., 2:]).clip(-_FAR_PX, _FAR_PX))

    def may_see(self, points: Array, reach_m: Array | float) -> NDArray[np.bool_]:
        """False for upright groups of world points (..., G, 3), grown by ``reach_m`` (...), out of view."""
        cam = self.to_camera(points)
        x, depth = cam[..., 0], cam[..., 2]
        left, right = self._sides
        reach = np.asarray(reach_m)[..., None]
        behind = (depth < NEAR_M - reach).all(axis=-1)
        beside_left = (x + left * depth < -reach * np.hypot(1, left)).all(axis=-1)
        beside_right = (x - right * depth > reach * np.hypot(1, right)).all(axis=-1)
        return np.asarray(~(behind | beside_left | beside_right))

    def polygon(self, points: Array) -> Array:
        """World polygon (K, 3) in the image (M, 2), clipped at the near plane; (0, 2) if it is behind."""
        if np.isfinite(self._step_m):
            points = subdivide(points, self._step_m)
        clipped = clip_near(self.to_camera(points))
        return self.pixels(clipped) if len(clipped) >= 3 else np.zeros((0, 2))

    def polygons(self, polygons: Sequence[Array]) -> list[Array]:
        """`polygon` of many at once."""
        if not polygons:
            return []
        if np.isfinite(self._step_m):
            polygons = [subdivide(p, self._step_m) for p in polygons]
        ends = np.cumsum([len(p) for p in polygons])
        cam = self.to_camera(np.concatenate(polygons))
        front = cam[:, 2] >= NEAR_M
        uv = self.pixels(np.where(front[:, None], cam, 1.0))
        out = []
        for start, end in zip(np.concatenate([[0], ends[:-1]]), ends, strict=True):
            if front[start:end].all():
                out.append(uv[start:end])
            elif front[start:end].any():
                out.append(self.pixels(clip_near(cam[start:end])))
            else:
                out.append(np.zeros((0, 2)))
        return out

    def fill_quads(self, image: Image, quads: Array, colour: Sequence[float]) -> None:
        """Fill many world quads (N, 4, 3) with one colour, leaving out what lies beside the image."""
        if not len(quads) or np.isfinite(self._step_m):
            for polygon in self.polygons(list(quads)):
                fill(image, polygon, colour)
            return
        cam = self.to_camera(quads)
        front = cam[..., 2] >= NEAR_M
        whole = front.all(axis=1)
        uv = self.pixels(cam[whole])
        inside = (uv.max(axis=1) > -1).all(axis=1) & (uv.min(axis=1) < np.array(self.size)).all(axis=1)
        for polygon in fixed_point(uv[inside]):
            cv2.fillConvexPoly(image, polygon, colour, cv2.LINE_8, SHIFT)
        for quad in cam[front.any(axis=1) & ~whole]:
            fill(image, self.pixels(clip_near(quad)), colour)

    @cached_property
    def rays(self) -> NDArray[np.float32]:
        """(3, H, W) directions of the pixels' rays in the world, with depth 1 along the optical axis."""
        w, h = self.size
        R = self.camera.T_world_cam.rotation
        if self.camera.has_distortion:
            uv = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1)
            xy = self.camera.undistort(uv)
            x, y = xy[..., 0], xy[..., 1]
        else:
            K = self.camera.K
            y = ((np.arange(h) - K[1, 2]) / K[1, 1])[:, None]
            x = (np.arange(w) - K[0, 2] - K[0, 1] * y) / K[0, 0]
        x32, y32 = x.astype(np.float32), y.astype(np.float32)
        R32 = R.astype(np.float32)
        return np.stack([R32[i, 0] * x32 + (R32[i, 1] * y32 + R32[i, 2]) for i in range(3)])


def fixed_point(uv: Array) -> NDArray[np.int32]:
    """Pixels (..., 2) as the rasteriser's fixed-point numbers."""
    return np.rint(uv * (1 << SHIFT)).astype(np.int32)


def fill(image: NDArray, uv: Array, colour: Sequence[float]) -> None:
    """Fill a convex polygon (K, 2) given in pixels."""
    if len(uv) >= 3:
        cv2.fillConvexPoly(image, fixed_point(uv), colour, cv2.LINE_8, SHIFT)


def fill_any(image: NDArray, uv: Array, colour: Sequence[float]) -> None:
    """Fill a simple polygon (K, 2) given in pixels that need not be convex."""
    if len(uv) >= 3:
        cv2.fillPoly(image, [fixed_point(uv)], colour, cv2.LINE_8, SHIFT)
