"""What stands still: textured ground with markings, houses, trees, poles, and the sky, drawn once for a camera."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks.other_bodies.driving import Crossing
from benchmarks.other_bodies.light import Light
from benchmarks.other_bodies.raster import rasterise
from wibam_core.geometry.camera import Camera

Array = NDArray[np.float64]
Layer = NDArray[np.float32]

_ROAD_M, _KERB_M, _WALK_M = 3.5, 6.3, 9.5
_SHADE_M, _SHADE_PX = 70.0, 1120
#: Numbers of `Thing` materials.
_WALL, _LEAVES, _BARK, _STEEL = range(4)
_COLOURS = {_BARK: (0.06, 0.08, 0.10), _STEEL: (0.3, 0.3, 0.3)}


@dataclass(frozen=True, eq=False)
class Thing:
    """A still body in the world: points (V, 3), outward normals (V, 3), faces (F, 3), material, and a number from which
    its looks follow."""

    points: Array
    normals: Array
    faces: NDArray[np.int64]
    material: int
    number: int


@dataclass(frozen=True, eq=False)
class Still:
    """One camera's view of what stands still, at the resolution that is drawn at.

    Attributes:
        lit, shaded: (H, W, 3) light with and without the sun on the ground. inverse_depth: (H, W) 1/m of things that
            stand, 0 where there is ground or sky.
    """

    lit: Layer
    shaded: Layer
    inverse_depth: Array


class Surroundings:
    """The world around a crossing; everything random in it follows from ``seed``."""

    def __init__(self, crossing: Crossing, light: Light, seed: int) -> None:
        rng = np.random.default_rng([seed, 3])
        self.crossing, self.light = crossing, light
        self._noise = [gaussian_filter(rng.standard_normal((256, 256)), sd, mode="wrap") for sd in (0.7, 2.5)]
        self._noise = [n / n.std() for n in self._noise]
        self._tone = rng.uniform(0.08, 0.16)
        self._patches = rng.uniform(-30, 30, (14, 2)), rng.uniform(0.4, 2.5, 14), rng.uniform(0.6, 1.25, 14)
        self.things = _things(crossing, rng)
        self._shade = self._shade_map()

    def seen_by(self, camera: Camera) -> Still:
        """Draw it."""
        width, height = camera.width_px, camera.height_px
        u, v = np.meshgrid(np.arange(width), np.arange(height))
        inverse_K = np.linalg.inv(camera.K)
        rays = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3) @ (camera.T_world_cam.rotation @ inverse_K).T
        lit = self.light.sky(rays / np.linalg.norm(rays, axis=1, keepdims=True))
        shaded = lit.copy()
        down = np.flatnonzero(rays[:, 2] < -1e-3)
        distance = -camera.centre_m[2] / rays[down, 2]
        ground = camera.centre_m[:2] + distance[:, None] * rays[down, :2]
        near = np.hypot(*ground.T) < 250
        down, ground, distance = down[near], ground[near], distance[near]
        albedo = self._ground(ground, distance / camera.K[0, 0])
        up = np.tile([0.0, 0.0, 1.0], (1, 1))
        full = self.light.irradiance(up)[0]
        sky = full - self.light.direct * self.light.sun[2] * np.array([0.90, 0.97, 1.0])
        share = self._in_shade(ground)[:, None]
        lit[down] = albedo * (full * (1 - share) + sky * share)
        shaded[down] = albedo * sky
        inverse_depth = np.zeros(width * height)
        for thing in self.things:
            self._draw(thing, camera, inverse_depth, lit, shaded)
        shape = (height, width, 3)
        layers = (layer.reshape(shape).astype(np.float32) for layer in (lit, shaded))
        return Still(*layers, inverse_depth.reshape(height, width))

    # --- ground -----------------------------------------------------------------------------
    def _field(self, number: int, x: Array, y: Array) -> Array:
        """Noise at places in units of its grain."""
        i, j = np.floor(x).astype(np.int64) & 255, np.floor(y).astype(np.int64) & 255
        return np.asarray(self._noise[number][j, i])

    def _ground(self, xy: Array, footprint_m: Array) -> Array:
        """(N, 3) albedo at ground points (N, 2); grain finer than a pixel's ``footprint_m`` (N,) is averaged out."""
        x, y = xy.T
        fine = np.clip(0.04 / np.maximum(footprint_m, 1e-3), 0.1, 1)
        grain = 0.09 * fine * self._field(0, x * 25, y * 25) + 0.07 * self._field(1, x * 2.2, y * 2.2)
        off = np.full(len(xy), np.inf)
        for arm in self.crossing.arms_rad:
            along, lateral = x * np.cos(arm) + y * np.sin(arm), -x * np.sin(arm) + y * np.cos(arm)
            off = np.minimum(off, np.where(along > 0, np.abs(lateral), np.hypot(x, y)))
        off = np.where(np.hypot(x, y) < 9.0, 0.0, off)
        grass = np.array([0.045, 0.11, 0.075]) * (1 + 0.5 * self._field(1, x * 5, y * 5)[:, None])
        slabs = (np.mod(x, 0.6) < 0.03) | (np.mod(y, 0.6) < 0.03)
        walk = np.array([0.27, 0.29, 0.30]) * np.where(slabs & (footprint_m < 0.05), 0.72, 1.0)[:, None]
        albedo = np.where((off < _WALK_M)[:, None], walk, grass)
        asphalt = np.full(len(xy), self._tone)
        for (px, py), radius, tone in zip(*self._patches, strict=True):
            asphalt = np.where((np.abs(x - px) < radius * 1.6) & (np.abs(y - py) < radius), asphalt * tone, asphalt)
        tracks = np.cos(np.clip(np.abs(off - _ROAD_M / 2) - 0.8, -0.5, 0.5) * np.pi)
        asphalt = asphalt * (1 - 0.12 * tracks * (off > 0))
        road = (off < _KERB_M)[:, None]
        albedo = np.where(road, asphalt[:, None] * np.array([1.0, 0.99, 0.97]), albedo)
        albedo = np.where(((off > _KERB_M) & (off < _KERB_M + 0.18))[:, None], 0.42, albedo)
        worn = 0.55 * np.clip(0.8 + 0.35 * self._field(1, x * 6, y * 6), 0, 1)[:, None]
        albedo = np.where(self._marked(x, y)[:, None], albedo * (1 - worn) + 0.75 * worn, albedo)
        return np.asarray(albedo * np.clip(1 + grain, 0.4, 1.8)[:, None])

    def _marked(self, x: Array, y: Array) -> NDArray[np.bool_]:
        marked = np.zeros(len(x), bool)
        stop = self.crossing.stop_m
        for arm in self.crossing.arms_rad:
            along, lateral = x * np.cos(arm) + y * np.sin(arm), -x * np.sin(arm) + y * np.cos(arm)
            incoming = (lateral > 0.1) & (lateral < _ROAD_M)
            marked |= (along > stop) & (along < stop + 0.4) & incoming
            marked |= (along > stop + 0.4) & (np.abs(lateral) < 0.06) & ((np.mod(along, 9) < 5) | (along < stop + 15))
            marked |= (along > stop) & (np.abs(np.abs(lateral) - _ROAD_M) < 0.06)
        return marked

    # --- things -----------------------------------------------------------------------------
    def _shade_map(self) -> Layer:
        """(P, P) share of the sun that things keep from the ground, x and y from −70 m to 70 m."""
        mask = np.zeros((_SHADE_PX, _SHADE_PX), np.uint8)
        sun = self.light.sun
        scale = _SHADE_PX / (2 * _SHADE_M)
        for thing in self.things:
            fallen = thing.points[:, :2] - thing.points[:, 2:] * sun[:2] / sun[2]
            for corners in ((fallen + _SHADE_M) * scale)[thing.faces]:
                cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 255)
        return np.asarray(cv2.GaussianBlur(mask.astype(np.float32) / 255, (0, 0), 1.5), dtype=np.float32)

    def _in_shade(self, xy: Array) -> Array:
        at = np.rint((xy + _SHADE_M) * _SHADE_PX / (2 * _SHADE_M)).astype(np.int64)
        inside = ((at >= 0) & (at < _SHADE_PX)).all(axis=1)
        at = np.clip(at, 0, _SHADE_PX - 1)
        return np.where(inside, self._shade[at[:, 1], at[:, 0]], 0.0)

    def _draw(self, thing: Thing, camera: Camera, inverse_depth: Array, lit: Array, shaded: Array) -> None:
        in_camera = camera.to_camera(thing.points)
        uv = camera.project_camera_points(np.concatenate([in_camera[:, :2], np.maximum(in_camera[:, 2:], 0.1)], axis=1))
        seen = rasterise(uv, in_camera[:, 2], thing.faces, (camera.width_px, camera.height_px))
        nearer = seen.inverse_depth > inverse_depth[seen.at]
        at, faces, weights = seen.at[nearer], seen.faces[nearer], seen.weights[nearer]
        inverse_depth[at] = seen.inverse_depth[nearer]
        points = np.einsum("ni,nij->nj", weights, thing.points[thing.faces[faces]])
        normals = np.einsum("ni,nij->nj", weights, thing.normals[thing.faces[faces]])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        colour = self._coloured(thing, points, normals) * self.light.irradiance(normals)
        lit[at], shaded[at] = colour, colour

    def _coloured(self, thing: Thing, points: Array, normals: Array) -> Array:
        x, y, z = points.T
        rng = np.random.default_rng(thing.number)
        if thing.material == _LEAVES:
            dark = 0.5 + 0.5 * np.clip(self._field(0, (x + z) * 5, (y - z) * 5) + 0.6, 0, 1.6)
            return np.asarray(np.array([0.04, 0.13, 0.08]) * rng.uniform(0.7, 1.4) * dark[:, None])
        if thing.material != _WALL:
            return np.tile(_COLOURS[thing.material], (len(points), 1))
        along = np.where(np.abs(normals[:, 0]) > np.abs(normals[:, 1]), y, x)
        wall = np.clip(np.array([0.30, 0.36, 0.42]) * rng.uniform(0.5, 1.7) + rng.normal(0, 0.04, 3), 0.03, 0.8)
        colour = wall * (1 + 0.06 * self._field(0, along * 6, z * 6))[:, None]
        spacing, storey = rng.uniform(1.6, 3.2), rng.uniform(2.7, 3.4)
        up = np.mod(z, storey) / storey
        window = (np.mod(along, spacing) < 0.45 * spacing) & (up > 0.35) & (up < 0.8)
        blinds = np.mod(np.floor(along / spacing) * 7 + np.floor(z / storey) * 13, 5) < 2
        colour[window] = np.where(blinds[window, None], 0.35, 0.06)
        return np.asarray(colour)


def _things(crossing: Crossing, rng: np.random.Generator) -> list[Thing]:
    arms = np.sort(np.mod(crossing.arms_rad, 2 * np.pi))
    things = []
    for k, first in enumerate(arms):
        gap = np.mod(arms[(k + 1) % len(arms)] - first, 2 * np.pi)
        bisector = first + gap / 2
        for _ in range(2 if gap < 2.2 else 4):
            angle = bisector + rng.uniform(-0.2, 0.2) * gap
            distance = rng.uniform(34, 48)
            place = distance * np.array([np.cos(angle), np.sin(angle)])
            things.append(_house(place, bisector + np.pi / 4, rng))
    for a in arms:
        d, n = np.array([np.cos(a), np.sin(a)]), np.array([-np.sin(a), np.cos(a)])
        for side in (-1, 1):
            for along in (rng.uniform(24, 34), rng.uniform(42, 60)):
                things += _tree(along * d + side * rng.uniform(8.0, 10.0) * n, rng)
            things.append(_pole(rng.uniform(13, 15) * d + side * 7.0 * n, rng.uniform(3, 8)))
    return things


def _house(place: Array, yaw: float, rng: np.random.Generator) -> Thing:
    x, y, z = rng.uniform(5, 9), rng.uniform(5, 9), rng.uniform(6, 15)
    corners = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    ring = corners @ turn.T + place
    points, normals, faces = [], [], []
    for k in range(4):
        a, b = ring[k], ring[(k + 1) % 4]
        outward = np.array([(b - a)[1], -(b - a)[0], 0.0]) / np.linalg.norm(b - a)
        start = len(points)
        points += [[*a, 0.0], [*b, 0.0], [*b, z], [*a, z]]
        normals += [outward] * 4
        faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    return Thing(np.array(points), np.array(normals), np.array(faces), _WALL, int(rng.integers(2**31)))


def _round(rings: Array, count: int, centre: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """A body of revolution through rings (R, 2) of radius and height about a place (2,)."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    x, y = np.cos(angle), np.sin(angle)
    circles = [np.stack([centre[0] + r * x, centre[1] + r * y, np.full(count, z)], axis=-1) for r, z in rings]
    points = np.concatenate(circles)
    i, j = np.meshgrid(np.arange(len(rings) - 1), np.arange(count), indexing="ij")
    a, b = i * count + j, i * count + (j + 1) % count
    halves = (np.stack([a, b, b + count], -1), np.stack([a, b + count, a + count], -1))
    faces = np.concatenate([half.reshape(-1, 3) for half in halves])
    normals = points - np.array([*centre, rings[:, 1].mean()])
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True), faces


def _tree(place: Array, rng: np.random.Generator) -> list[Thing]:
    radius, height, low = rng.uniform(1.6, 2.8), rng.uniform(5, 9), rng.uniform(2.2, 3.0)
    t = np.linspace(0.02, 1, 9)
    crown = np.stack([radius * np.sin(np.pi * np.minimum(t, 0.98)) ** 0.7, low + t * (height - low)], axis=-1)
    points, normals, faces = _round(crown, 16, place)
    points = points + rng.normal(0, 0.14 * radius, points.shape)
    trunk = _round(np.array([[0.16, 0.0], [0.14, low + 0.3]]), 8, place)
    return [Thing(points, normals, faces, _LEAVES, int(rng.integers(2**31))), Thing(*trunk, _BARK, 0)]


def _pole(place: Array, height: float) -> Thing:
    return Thing(*_round(np.array([[0.08, 0.0], [0.06, height]]), 8, place), _STEEL, 0)
