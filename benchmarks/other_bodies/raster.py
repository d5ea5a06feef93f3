"""A z-buffer: which triangle is seen at each pixel, and where on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Nothing nearer than this to the camera's plane is drawn, m.
NEAR_M = 0.4
_STEPS_PX = np.array([2, 5, 12, 30, 80, 250, 1000, 8000])


@dataclass(frozen=True, eq=False)
class Seen:
    """Pixels (M,) that show a mesh, each once.

    Attributes:
        at: (M,) row · width + column. inverse_depth: (M,) 1/m along the optical axis.
        faces: (M,) numbers. weights: (M, 3) of the face's three points, true in space and not only in the image.
    """

    at: IntArray
    inverse_depth: Array
    faces: IntArray
    weights: Array


def rasterise(uv: Array, depth_m: Array, faces: IntArray, size_px: tuple[int, int]) -> Seen:
    """The front faces of a mesh with image points (V, 2), px, at depths (V,).

    Args:
        uv: pixel (0, 0) has its centre at 0, 0.
        depth_m: along the optical axis; faces with a point nearer than `NEAR_M` are left out.
        faces: (F, 3), counter-clockwise as seen from outside; v points down, so that they are seen clockwise.
        size_px: width and height of the image.
    """
    faces_of = np.flatnonzero((depth_m[faces] > NEAR_M).all(axis=1))
    corners = uv[faces[faces_of]]
    area = _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    low = np.ceil(np.maximum(corners.min(axis=1), 0.0)).astype(np.int64)
    high = np.floor(np.minimum(corners.max(axis=1), np.array(size_px) - 1.0)).astype(np.int64)
    extent = high - low + 1
    keep = (area < 0) & (extent > 0).all(axis=1)
    faces_of, corners, area, low, extent = faces_of[keep], corners[keep], area[keep], low[keep], extent[keep]
    inverse = 1.0 / np.maximum(depth_m[faces[faces_of]], NEAR_M)
    found: list[tuple[Array, ...]] = []
    # triangles of about one size are filled together
    size = np.searchsorted(_STEPS_PX, extent)
    kind = size[:, 0] * len(_STEPS_PX) + size[:, 1]
    for code in np.unique(kind).tolist():
        own = np.flatnonzero(kind == code)
        wide, high_px = int(extent[own, 0].max()), int(extent[own, 1].max())
        block = max(1, 2_000_000 // (wide * high_px))
        for begin in range(0, len(own), block):
            rows = own[begin : begin + block]
            found.append(_filled(corners[rows], area[rows], low[rows], extent[rows], inverse[rows], rows, size_px[0]))
    if not found:
        return Seen(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 3)))
    at, near, number, weights = (np.concatenate(column) for column in zip(*found, strict=True))
    order = np.lexsort((-near, at))
    first = np.ones(len(order), bool)
    first[1:] = at[order[1:]] != at[order[:-1]]
    best = order[first]
    return Seen(at[best].astype(np.int64), near[best], faces_of[number[best].astype(np.int64)], weights[best])


def _filled(
    corners: Array, area: Array, low: IntArray, extent: IntArray, inverse: Array, rows: IntArray, width: int
) -> tuple[Array, ...]:
    """Pixel, inverse depth, triangle and weights of everything that some triangles (T, 3, 2) cover."""
    wide, high = extent.max(axis=0)
    x = low[:, 0, None, None] + np.arange(wide)[None, None, :]
    y = low[:, 1, None, None] + np.arange(high)[None, :, None]
    shares = []
    for k in range(3):
        a, b = corners[:, (k + 1) % 3, :, None, None], corners[:, (k + 2) % 3, :, None, None]
        edge = (b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])
        shares.append(edge / area[:, None, None])
    inside = (shares[0] >= 0) & (shares[1] >= 0) & (shares[2] >= 0)
    inside &= (x < (low + extent)[:, 0, None, None]) & (y < (low + extent)[:, 1, None, None])
    t, j, i = np.nonzero(inside)
    flat = np.stack([share[t, j, i] for share in shares], axis=-1) * inverse[t]
    near = flat.sum(axis=1)
    return (low[t, 1] + j) * width + low[t, 0] + i, near, rows[t], flat / near[:, None]


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
