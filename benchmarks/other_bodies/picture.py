"""One camera's picture of vehicles among what stands still, and which pixels show whom."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.other_bodies.bodies import body
from benchmarks.other_bodies.driving import Vehicle
from benchmarks.other_bodies.light import Light, reflected
from benchmarks.other_bodies.materials import surface
from benchmarks.other_bodies.raster import NEAR_M, rasterise
from benchmarks.other_bodies.surroundings import Surroundings
from wibam_core.geometry.camera import Camera

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Pictures are drawn this many times as wide and high, and averaged.
_FINER = 2
#: How much darker the ground is right below a vehicle, and how far blurred shadows reach, px.
_CONTACT, _MARGIN_PX = 0.55, 12


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture with its truth, one row for each vehicle given.

    Attributes:
        linear: (H, W, 3) light. visible_boxes, amodal_boxes: (N, 4) xyxy px, around what is seen, and around the whole
            silhouette within the image; zeros where there is nothing. visibility: (N,) share of the silhouette that is
            seen, of what lies beyond the border included.
    """

    linear: NDArray[np.float32]
    visible_boxes: Array
    amodal_boxes: Array
    visibility: Array


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A vehicle by itself: pixels (M,), their inverse depths and colours, silhouette and shadow."""

    at: IntArray
    inverse_depth: Array
    colours: Array
    bounds: Array
    share_in_view: float
    shadow: tuple[Array, ...]
    contact: Array


class Painter:
    """Draws what one camera sees.

    Args:
        camera: a pinhole without distortion. surroundings: the world.
    """

    def __init__(self, camera: Camera, surroundings: Surroundings) -> None:
        self.camera = camera
        self._fine = camera.resized(camera.width_px * _FINER, camera.height_px * _FINER)
        self._still = surroundings.seen_by(self._fine)
        self._light: Light = surroundings.light
        self._cache: dict[int, tuple[tuple[float, ...], _Drawn | None]] = {}

    def draw(self, vehicles: list[Vehicle], poses: list[Array]) -> Picture:
        """Vehicles at poses (x, y, yaw)."""
        width, height = self._fine.width_px, self._fine.height_px
        drawn = [self._cached(vehicle, pose) for vehicle, pose in zip(vehicles, poses, strict=True)]
        image = self._with_shadows([d for d in drawn if d is not None]).reshape(-1, 3)
        depth, owner = self._still.inverse_depth.ravel().copy(), np.zeros(width * height, np.int64)
        for number, one in enumerate(drawn):
            if one is not None:
                nearer = one.inverse_depth > depth[one.at]
                at = one.at[nearer]
                depth[at], owner[at], image[at] = one.inverse_depth[nearer], number + 1, one.colours[nearer]
        n = len(drawn)
        visible, amodal, visibility = np.zeros((n, 4)), np.zeros((n, 4)), np.zeros(n)
        limits = np.array([self.camera.width_px, self.camera.height_px]) - 0.5
        for number, one in enumerate(drawn):
            if one is None:
                continue
            amodal[number] = np.concatenate([np.maximum(one.bounds[:2], -0.5), np.minimum(one.bounds[2:], limits)])
            own = one.at[owner[one.at] == number + 1]
            if len(own):
                v, u = np.divmod(own, width)
                edges = np.array([u.min(), v.min(), u.max() + 1, v.max() + 1]) / _FINER - 0.5
                visible[number] = edges
                visibility[number] = len(own) / len(one.at) * one.share_in_view
        whole = image.reshape(height, width, 3)
        small = cv2.resize(whole, (self.camera.width_px, self.camera.height_px), interpolation=cv2.INTER_AREA)
        return Picture(np.asarray(small, dtype=np.float32), visible, amodal, visibility)

    def _cached(self, vehicle: Vehicle, pose: Array) -> _Drawn | None:
        """Who stands is drawn once."""
        key = tuple(np.round(pose, 4).tolist())
        held = self._cache.get(vehicle.vehicle_id)
        if held is None or held[0] != key:
            held = (key, self._drawn(vehicle, pose))
            self._cache[vehicle.vehicle_id] = held
        return held[1]

    def _drawn(self, vehicle: Vehicle, pose: Array) -> _Drawn | None:
        mesh, camera = body(vehicle.model), self._fine
        c, s = np.cos(pose[2]), np.sin(pose[2])
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        world = mesh.points @ turn.T + [pose[0], pose[1], 0.0]
        in_camera = camera.to_camera(world)
        if (in_camera[:, 2] < NEAR_M).any():
            return None
        uv = camera.project_camera_points(in_camera)
        low, high = uv.min(axis=0), uv.max(axis=0)
        if (high < 0).any() or (low > np.array([camera.width_px, camera.height_px]) - 1).any():
            return None
        seen = rasterise(uv, in_camera[:, 2], mesh.faces, (camera.width_px, camera.height_px))
        if not len(seen.at):
            return None
        corners = mesh.faces[seen.faces]
        points = np.einsum("ni,nij->nj", seen.weights, mesh.points[corners])
        normals = np.einsum("ni,nij->nj", seen.weights, mesh.normals[corners])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        of = surface(vehicle.model, vehicle.finish, points, normals, mesh.pieces[corners[:, 0]])
        out = normals @ turn.T
        views = points @ turn.T + [pose[0], pose[1], 0.0] - camera.centre_m
        views /= np.linalg.norm(views, axis=1, keepdims=True)
        facing = np.clip(-np.einsum("ij,ij->i", views, out), 0, 1)
        fresnel = of.mirror + (of.mirror > 0.03) * (0.9 - of.mirror) * (1 - facing) ** 5
        hidden_sky = np.clip(0.35 + points[:, 2:] / 0.7, 0.35, 1.0)
        colours = of.albedo * self._light.irradiance(out) * hidden_sky + of.glow
        colours = colours + fresnel[:, None] * self._light.radiance(reflected(views, out))
        bounds = (np.concatenate([low, high]) + 0.5) / _FINER - 0.5
        return _Drawn(
            seen.at, seen.inverse_depth, colours.astype(np.float32), bounds, self._share_in_view(uv),
            self._shadow(world), self._contact(vehicle, turn, pose),
        )  # fmt: skip

    def _share_in_view(self, uv: Array) -> float:
        """Share of the outline's hull that lies within the image."""
        hull = cv2.convexHull(uv.astype(np.float32))[:, 0]
        w, h = self._fine.width_px, self._fine.height_px
        image = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32) - np.float32(0.5)
        inside, _ = cv2.intersectConvexConvex(hull, image)
        return float(np.clip(inside / max(cv2.contourArea(hull), 1e-6), 0, 1))

    def _shadow(self, world: Array) -> tuple[Array, ...]:
        """Where the sun's shadow falls: convex pieces, px, of slices of the body across its length."""
        sun = self._light.sun
        fallen = world[:, :2] - world[:, 2:] * sun[:2] / sun[2]
        axis = fallen - fallen.mean(axis=0)
        along = axis @ np.linalg.svd(axis, full_matrices=False)[2][0]
        pieces = []
        cuts = np.linspace(along.min(), along.max(), 7)
        for a, b in pairwise(cuts):
            own = fallen[(along >= a - 0.15) & (along <= b + 0.15)]
            if len(own) >= 3:
                pieces.append(self._ground_px(cv2.convexHull(own.astype(np.float32))[:, 0]))
        return tuple(piece for piece in pieces if len(piece))

    def _contact(self, vehicle: Vehicle, turn: Array, pose: Array) -> Array:
        half = 0.5 * np.array([vehicle.model.length_m, vehicle.model.width_m]) * 0.98
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half
        return self._ground_px(corners @ turn[:2, :2].T + pose[:2])

    def _ground_px(self, ground: Array) -> Array:
        """(K, 2) px of ground points, or none if one lies behind the camera."""
        points = self._fine.to_camera(np.concatenate([ground, np.zeros((len(ground), 1))], axis=1))
        if (points[:, 2] < NEAR_M).any():
            return np.zeros((0, 2))
        return np.asarray(self._fine.project_camera_points(points))

    def _with_shadows(self, drawn: list[_Drawn]) -> NDArray[np.float32]:
        """The still picture with the shadows of vehicles on the ground."""
        still = self._still
        image = still.lit.copy()
        outlines = [piece for one in drawn for piece in (*one.shadow, one.contact) if len(piece)]
        if not outlines:
            return image
        height, width = still.inverse_depth.shape
        ends = np.concatenate(outlines)
        x0, y0 = np.clip(ends.min(axis=0).astype(int) - _MARGIN_PX, 0, [width, height]).tolist()
        x1, y1 = np.clip(ends.max(axis=0).astype(int) + _MARGIN_PX, 0, [width, height]).tolist()
        if x1 <= x0 or y1 <= y0:
            return image
        sun, near = np.zeros((y1 - y0, x1 - x0), np.uint8), np.zeros((y1 - y0, x1 - x0), np.uint8)
        corner = np.array([x0, y0])
        for one in drawn:
            for piece in one.shadow:
                cv2.fillConvexPoly(sun, _fixed(piece - corner), 255, cv2.LINE_AA, 4)
            if len(one.contact):
                cv2.fillConvexPoly(near, _fixed(one.contact - corner), 255, cv2.LINE_AA, 4)
        part = np.s_[y0:y1, x0:x1]
        sun[still.inverse_depth[part] > 0] = 0
        near[still.inverse_depth[part] > 0] = 0
        share = cv2.GaussianBlur(sun, (0, 0), 1.2).astype(np.float32)[..., None] / np.float32(255)
        dark = cv2.GaussianBlur(near, (0, 0), 3.0).astype(np.float32)[..., None] / np.float32(255)
        image[part] += share * (still.shaded[part] - image[part])
        image[part] *= 1 - np.float32(_CONTACT) * dark
        return image


def _fixed(points: Array) -> NDArray[np.int32]:
    return np.rint(np.clip(points, -20000, 20000) * 16).astype(np.int32)
