"""Solid bodies made of convex parts, drawn by painter's order.

A body is a `Mesh`: points in its own frame (vehicle frame for vehicles), convex `Part`s with flat faces, and a tree of
separating planes that gives the order in which the parts must be painted for a given viewpoint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Split:
    """Parts on both sides of the plane ``axis = value`` in the body's frame; leaves are part numbers."""

    axis: int
    value: float
    low: Split | int
    high: Split | int


def paint_order(tree: Split | int, viewpoint: Array) -> list[int]:
    """Part numbers from far to near as seen from ``viewpoint`` (3,), in the body's frame."""
    if isinstance(tree, int):
        return [tree]
    near, far = (tree.high, tree.low) if viewpoint[tree.axis] > tree.value else (tree.low, tree.high)
    return paint_order(far, viewpoint) + paint_order(near, viewpoint)


@dataclass(frozen=True, eq=False)
class Part:
    """A convex part: ``hull`` point numbers (its silhouette is their convex hull), ``faces`` face numbers."""

    hull: IntArray
    faces: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A body. Faces are painted in their order within a part, so what lies on a face follows it.

    Attributes:
        points: (V, 3) in the body's frame, m.
        faces: point numbers of every face.
        normals: (F, 3) outward unit normals. centres: (F, 3).
        colours: (F, 3) BGR in 0..255.
        glow: (F,) share of the colour that does not depend on the light.
        detail: (F,) faces that are left out when the body is small in the image.
        parts: convex parts. order: separating planes between them.
        wheels: per wheel the point numbers of its outer and inner disc, and its side (+1 left, −1 right).
    """

    points: Array
    faces: tuple[IntArray, ...]
    normals: Array
    centres: Array
    colours: Array
    glow: Array
    detail: NDArray[np.bool_]
    parts: tuple[Part, ...]
    order: Split | int
    wheels: tuple[tuple[IntArray, IntArray, int], ...]


class MeshBuilder:
    """Collects parts; `build` scales the whole to an exact size."""

    def __init__(self) -> None:
        self._points: list[Array] = []
        self._faces: list[IntArray] = []
        self._colours: list[Colour] = []
        self._glow: list[float] = []
        self._detail: list[bool] = []
        self._insides: list[Array] = []
        self._parts: list[Part] = []
        self._wheels: list[tuple[IntArray, IntArray, int]] = []
        self._count = 0

    def _add_points(self, points: Array) -> IntArray:
        numbers = np.arange(self._count, self._count + len(points))
        self._points.append(points)
        self._count += len(points)
        return numbers

    def _add_face(self, numbers: IntArray, colour: Colour, inside: Array, glow: float, detail: bool) -> int:
        self._faces.append(np.asarray(numbers, dtype=np.int64))
        self._colours.append(colour)
        self._insides.append(inside)
        self._glow.append(glow)
        self._detail.append(detail)
        return len(self._faces) - 1

    def add_loft(self, rings: Sequence[Array], colours: Sequence[Colour], patches: Sequence[Patch] = ()) -> int:
        """A convex part spanned by rings (8, 3) from bottom to top (see `ring`), closed on top.

        Args:
            rings: from bottom to top.
            colours: one per layer between rings, and the lid's.
            patches: what is painted on the faces.

        Returns:
            the part's number.
        """
        numbers = [self._add_points(r) for r in rings]
        inside = np.concatenate(rings).mean(axis=0)
        painted: dict[tuple[int, int], list[tuple[Patch, IntArray]]] = {}
        for patch, corners in zip(patches, _patch_corners(patches, rings), strict=True):
            painted.setdefault((patch.layer, patch.side), []).append((patch, self._add_points(corners)))
        faces = []
        for layer in range(len(rings) - 1):
            low, high = numbers[layer], numbers[layer + 1]
            for side in range(8):
                nxt = (side + 1) % 8
                quad = np.array([low[side], low[nxt], high[nxt], high[side]])
                faces.append(self._add_face(quad, colours[layer], inside, 0.0, False))
                for patch, on in painted.get((layer, side), ()):
                    faces.append(self._add_face(on, patch.colour, inside, patch.glow, True))
        faces.append(self._add_face(numbers[-1], colours[-1], inside, 0.0, False))
        self._parts.append(Part(np.concatenate(numbers), tuple(faces)))
        return len(self._parts) - 1

    def add_wheel(self, x: float, y: float, radius: float, width: float) -> None:
        """A wheel that stands on z = 0, its outer disc at ``y``."""
        side = 1 if y > 0 else -1
        angle = np.linspace(0, 2 * np.pi, 12, endpoint=False) - np.pi / 2
        disc = np.stack([x + radius * np.cos(angle), np.full(12, y), radius * (1 + np.sin(angle))], axis=-1)
        outer = self._add_points(disc)
        inner = self._add_points(disc - np.array([0, side * width, 0]))
        self._wheels.append((outer, inner, side))

    def build(self, size_m: tuple[float, float, float], order: Split | int) -> Mesh:
        """The body scaled so that its tight extent is exactly ``size_m`` about the origin."""
        points = np.concatenate(self._points)
        low, high = points.min(axis=0), points.max(axis=0)
        size = np.array(size_m)
        scale = size / (high - low)
        middle = (low + high) / 2

        def scaled(p: Array) -> Array:
            return (p - middle) * scale

        points = np.clip(scaled(points), -size / 2, size / 2)
        # four well-spread corners of every face: enough for its centre and normal, as faces are flat
        corners = points[np.array([[f[len(f) * i // 4] for i in range(4)] for f in self._faces])]
        centres = corners.mean(axis=1)
        normals = _cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        inward = np.einsum("ij,ij->i", normals, centres - scaled(np.array(self._insides))) < 0
        normals[inward] *= -1
        return Mesh(
            points=points,
            faces=tuple(self._faces),
            normals=normals,
            centres=centres,
            colours=np.array(self._colours),
            glow=np.array(self._glow),
            detail=np.array(self._detail),
            parts=tuple(self._parts),
            order=_scaled_order(order, middle, scale),
            wheels=tuple(self._wheels),
        )


def _cross(a: Array, b: Array) -> Array:
    """Cross product of rows (N, 3)."""
    return np.stack([a[:, i - 2] * b[:, i - 1] - a[:, i - 1] * b[:, i - 2] for i in range(3)], axis=1)


def _scaled_order(tree: Split | int, middle: Array, scale: Array) -> Split | int:
    if isinstance(tree, int):
        return tree
    value = float((tree.value - middle[tree.axis]) * scale[tree.axis])
    return Split(tree.axis, value, _scaled_order(tree.low, middle, scale), _scaled_order(tree.high, middle, scale))


#: Sides of a ring's layers, in the order of `ring`.
FRONT, FRONT_LEFT, LEFT, REAR_LEFT, REAR, REAR_RIGHT, RIGHT, FRONT_RIGHT = range(8)


def ring(front_m: float, rear_m: float, half_width_m: float, chamfer_m: float, z_m: tuple[float, float]) -> Array:
    """(8, 3) rectangle with cut corners, counter-clockwise from above.

    ``z_m`` is the height in front and at the rear.
    """
    w, c = half_width_m, min(chamfer_m, half_width_m * 0.9)
    x = np.array([front_m, front_m, front_m - c, rear_m + c, rear_m, rear_m, rear_m + c, front_m - c])
    y = np.array([c - w, w - c, w, w, w - c, c - w, -w, -w])
    z = z_m[1] + (z_m[0] - z_m[1]) * (x - rear_m) / (front_m - rear_m)
    return np.stack([x, y, z], axis=-1)


@dataclass(frozen=True)
class Patch:
    """A quad painted on one face of a loft: a window, a lamp, a plate.

    Attributes:
        layer, side: which face.
        u, v: extent along the face (0 at its first corner going counter-clockwise) and from bottom to top, in 0..1.
        colour: BGR. glow: share of the colour that does not depend on the light.
    """

    layer: int
    side: int
    u: tuple[float, float]
    v: tuple[float, float]
    colour: Colour
    glow: float = 0.0


def _patch_corners(patches: Sequence[Patch], rings: Sequence[Array]) -> Array:
    """(P, 4, 3) corners of patches on the faces between rings: low first, low second, high second, high first."""
    if not patches:
        return np.zeros((0, 4, 3))
    stacked = np.array(rings)
    layer = np.array([p.layer for p in patches])
    side = np.array([p.side for p in patches])
    u = np.array([p.u for p in patches])[:, [0, 1, 1, 0], None]
    v = np.array([p.v for p in patches])[:, [0, 0, 1, 1], None]
    nxt = (side + 1) % 8
    low = stacked[layer, side][:, None] * (1 - u) + stacked[layer, nxt][:, None] * u
    high = stacked[layer + 1, side][:, None] * (1 - u) + stacked[layer + 1, nxt][:, None] * u
    return np.asarray(low * (1 - v) + high * v)
