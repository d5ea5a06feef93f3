"""Lofted meshes: cross-sections along a side profile, wheels, mirrors, and a separate cargo body for trucks."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from benchmarks.other_bodies.catalogue import BodyModel

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Stations along a loft, and points around a wheel.
_STATIONS, _SPOKES = 34, 18
_TYRE_WIDTH_M = 0.22
_MIRROR_M = (0.12, 0.19, 0.17)


class Piece(IntEnum):
    """What a point of a mesh belongs to: materials differ by it."""

    SHELL, CARGO, CHASSIS, TYRE, RIM, MIRROR = range(6)


@dataclass(frozen=True, eq=False)
class Body:
    """A mesh in the vehicle's frame: x forward, y left, z up, origin on the ground below the middle of its extent.

    Attributes:
        model: what it shows.
        points: (V, 3) m. normals: (V, 3) outward, unit, smooth over curved surfaces. pieces: (V,) `Piece`.
        faces: (F, 3) numbers of points, counter-clockwise as seen from outside.
    """

    model: BodyModel
    points: Array
    normals: Array
    pieces: IntArray
    faces: IntArray


@cache
def body(model: BodyModel) -> Body:
    """The mesh of a model. Without its mirrors it fills its published length, width and height exactly."""
    parts = [_shell(model)]
    if model.cargo is not None:
        parts += [_cargo(model), _chassis(model)]
    points, faces = _joined(parts)
    low, high = points.min(axis=0), points.max(axis=0)
    low[2] = 0.0
    scale = np.array([model.length_m, model.width_m, model.height_m]) / (high - low)
    parts = [((p - [*(low + high)[:2] / 2, 0.0]) * scale, f) for p, f in parts]
    kinds = [Piece.SHELL, Piece.CARGO, Piece.CHASSIS][: len(parts)]
    for x in axles_m(model):
        for side in (1.0, -1.0):
            tyre, rim = _wheel(x, side, model)
            parts += [tyre, rim]
            kinds += [Piece.TYRE, Piece.RIM]
    if model.mirrors is not None:
        for side in (1.0, -1.0):
            parts.append(_mirror(model, side))
            kinds.append(Piece.MIRROR)
    points, faces = _joined(parts)
    pieces = np.repeat(kinds, [len(p) for p, _ in parts])
    return Body(model, points, _normals(points, faces), pieces, faces)


def axles_m(model: BodyModel) -> Array:
    """Places of the axles along the vehicle, from the middle of its length, m."""
    first = model.length_m / 2 - model.front_overhang_m
    return np.asarray(first - model.wheelbase_m * np.array([0.0, *model.axles, 1.0]))


def upper_m(model: BodyModel, x_m: Array) -> Array:
    """Height (N,) of the shell's upper contour at places (N,) along the vehicle from its middle, m."""
    share, height = np.array(model.top).T
    curve = PchipInterpolator(share, height)
    return np.asarray(curve(np.clip(0.5 - x_m / model.length_m, 0, 1)) * model.height_m)


Part = tuple[Array, IntArray]


def _shell(model: BodyModel) -> Part:
    """The loft of a car, a van, a bus or a cab: sections whose upper end follows the profile."""
    rear = model.cab_rear
    # close together at both ends, where contours are round
    share = rear * 0.5 * (1 - np.cos(np.linspace(0, np.pi, _STATIONS)))
    extra = [s for s, _ in model.top if s < rear]
    share = np.unique(np.round(np.concatenate([share, extra]), 4))
    x = (0.5 - share) * model.length_m
    top = upper_m(model, x)
    half = model.width_m / 2 * _plan(share * model.length_m, rear * model.length_m, model)
    low = model.clearance_m + 0.10 * model.height_m * (1 - np.clip(share / 0.05, 0, 1)) ** 2
    low += 0.12 * model.height_m * (1 - np.clip((rear - share) / 0.08, 0, 1)) ** 2 * (model.cargo is None)
    low = np.minimum(low, top - 0.15)
    waist = np.minimum(model.waist * model.height_m, top - 0.015)
    waist = np.maximum(waist, low + 0.1)
    above = top - waist
    inset = 1 - (1 - model.roof_width) * np.clip(above / ((1 - model.waist) * model.height_m), 0, 1)
    rounding = np.minimum(0.10, 0.45 * above)
    rows = []
    for w, u, b, t, r, i in zip(half, low, waist, top, rounding, inset, strict=True):
        belly = u + 0.32 * (b - u)
        rows.append(
            [
                (0.0, u), (0.84 * w, u), (0.95 * w, u + 0.07 * (b - u)), (0.995 * w, belly), (w, u + 0.6 * (b - u)),
                (0.985 * w, b - 0.12 * (b - u)), (0.955 * w, b),
                (w * (0.955 + 0.5 * (0.955 * i - 0.955)) + 0.012 * (t > b + 0.1), b + 0.5 * (t - r - b)),
                (0.955 * w * i, t - r), (0.89 * w * i, t - 0.35 * r), (0.62 * w * i, t - 0.08 * r), (0.0, t),
            ]
        )  # fmt: skip
    return _loft(x, np.array(rows))


def _plan(from_front_m: Array, length_m: float, model: BodyModel) -> Array:
    """(N,) share of the half width at distances behind the front: corners are superellipses in plan."""
    share = np.ones_like(from_front_m)
    for distance, radius in ((from_front_m, model.nose), (length_m - from_front_m, model.tail)):
        radius_m = radius * model.width_m
        off = np.clip(1 - distance / max(radius_m, 1e-3), 0, 1)
        share *= 1 - 0.42 * np.clip(radius / 0.3, 0, 1) * off**2.6
    return share


def _cargo(model: BodyModel) -> Part:
    cargo = model.cargo
    assert cargo is not None
    front, rear = (0.5 - cargo.start) * model.length_m, -model.length_m / 2
    return _tube(front, rear, cargo.width_m / 2, cargo.floor_m, cargo.top_m, 0.04)


def _chassis(model: BodyModel) -> Part:
    assert model.cargo is not None
    front, rear = (0.5 - 0.5 * model.cab_rear) * model.length_m, -model.length_m / 2 + 0.25
    return _tube(front, rear, 0.42, 0.5, model.cargo.floor_m + 0.01, 0.03)


def _tube(front: float, rear: float, half: float, low: float, high: float, bevel: float) -> Part:
    """A long box with bevelled edges."""
    middle = (low + high) / 2
    section = [
        (0.0, low), (half - bevel, low), (half, low + bevel), (half, middle), (half, high - bevel),
        (half - bevel, high), (0.0, high),
    ]  # fmt: skip
    x = np.linspace(front, rear, 9)
    return _loft(x, np.repeat(np.array(section)[None], len(x), axis=0))


def _loft(x: Array, sections: Array) -> Part:
    """Half sections (S, P, 2) of y and z at places ``x`` (S,) from front to rear, mirrored, and closed at the ends."""
    s, p = sections.shape[:2]
    mirrored = sections[:, -2:0:-1] * [-1, 1]
    around = np.concatenate([sections, mirrored], axis=1)
    count = around.shape[1]
    points = np.concatenate([np.broadcast_to(x[:, None, None], (s, count, 1)), around], axis=2).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(s - 1), np.arange(count), indexing="ij")
    a, b = i * count + j, i * count + (j + 1) % count
    c, d = a + count, b + count
    faces = np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])
    caps = []
    for row, turn in ((0, -1), (s - 1, 1)):
        start = len(points)
        ring = points[row * count : (row + 1) * count]
        points = np.concatenate([points, ring, [[x[row], 0.0, (ring[0, 2] + ring[p - 1, 2]) / 2]]])
        k = np.arange(count)
        cap = np.stack([np.full(count, start + count), start + k, start + (k + 1) % count], axis=-1)
        caps.append(cap[:, ::turn])
    return points, _outward(points, np.concatenate([faces, *caps]))


def _outward(points: Array, faces: IntArray) -> IntArray:
    """Faces turned so that the closed mesh has a positive volume."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c))
    return faces if volume > 0 else faces[:, ::-1]


def _wheel(x: float, side: float, model: BodyModel) -> tuple[Part, Part]:
    radius, outer = model.wheel_m / 2, 0.985 * model.width_m / 2
    angle = np.linspace(0, 2 * np.pi, _SPOKES, endpoint=False) - np.pi / 2  # the first point stands on the ground
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    widths, radii = (outer - _TYRE_WIDTH_M, outer - 0.02, outer, outer), (radius, radius, 0.94 * radius, 0.66 * radius)
    ring = [
        np.stack([x + r * circle[:, 0], np.full(_SPOKES, side * y), radius + r * circle[:, 1]], axis=-1)
        for y, r in zip(widths, radii, strict=True)
    ]
    hub = np.array([[x, side * (outer - 0.03), radius]])
    k, following = np.arange(_SPOKES), (np.arange(_SPOKES) + 1) % _SPOKES
    bands = []
    for n in range(3):
        a, b, c, d = n * _SPOKES + k, n * _SPOKES + following, (n + 1) * _SPOKES + k, (n + 1) * _SPOKES + following
        bands += [np.stack([a, b, d], -1), np.stack([a, d, c], -1)]
    tyre = np.concatenate(bands)
    rim_faces = np.stack([np.full(_SPOKES, _SPOKES), k, following], axis=-1)
    # the hub's side decides which way its disc looks
    turn = 1 if side < 0 else -1
    return (np.concatenate(ring), tyre[:, ::turn]), (np.concatenate([ring[3], hub]), rim_faces[:, ::turn])


def _mirror(model: BodyModel, side: float) -> Part:
    assert model.mirrors is not None
    length, width, height = (m * (1.0 if model.height_m < 2 else 1.5) for m in _MIRROR_M)
    x = (0.5 - model.mirrors) * model.length_m
    points, faces = _tube(x + length / 2, x - length / 2, width / 2, 0.0, height, 0.03)
    place = np.array([0.0, side * (model.width_m / 2 + width / 2 - 0.02), model.waist * model.height_m])
    return points + place, faces


def _joined(parts: list[Part]) -> Part:
    starts = np.cumsum([0, *(len(p) for p, _ in parts[:-1])])
    faces = np.concatenate([f + start for (_, f), start in zip(parts, starts, strict=True)])
    return np.concatenate([p for p, _ in parts]), faces


def _normals(points: Array, faces: IntArray) -> Array:
    """(V, 3) means of the faces' normals, weighted by area."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    total = np.zeros_like(points)
    for k in range(3):
        np.add.at(total, faces[:, k], cross)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12))
