"""Exact overlaps of upright boxes: footprints in bird's-eye view, and volumes. Image boxes: see `boxes2d`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.geometry.box3d import HEIGHT, LENGTH, SIZE, WIDTH, XY, YAW, Z, footprints

Array = NDArray[np.float64]


def _as_boxes(boxes: ArrayLike) -> Array:
    return np.asarray(boxes, dtype=np.float64).reshape(-1, 7)


def _clip_convex(polygons: Array, normals: Array, offsets: Array) -> Array:
    """Clip convex polygons (P, n, 2) by half-planes ``normals · x <= offsets`` (P, 2), (P,); gives (P, n + 1, 2).

    Unused slots repeat the first vertex, which leaves the area alone; a polygon that vanishes becomes all zeros.
    """
    side = offsets[:, None] - np.einsum("pnk,pk->pn", polygons, normals)
    after = np.roll(polygons, -1, axis=1)
    side_after = np.roll(side, -1, axis=1)
    inside = side >= 0
    crosses = inside != (side_after >= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(crosses, side / (side - side_after), 0.0)
    crossing = polygons + t[..., None] * (after - polygons)
    n = polygons.shape[1]
    slots = np.stack([polygons, crossing], axis=2).reshape(len(polygons), 2 * n, 2)
    used = np.stack([inside, crosses], axis=2).reshape(len(polygons), 2 * n)
    order = np.argsort(~used, axis=1, kind="stable")[:, : n + 1]
    clipped = np.take_along_axis(slots, order[..., None], axis=1)
    used = np.take_along_axis(used, order, axis=1)
    clipped = np.where(used[..., None], clipped, clipped[:, :1])
    return np.where(used[:, :1, None], clipped, 0.0)


def _area(polygons: Array) -> Array:
    after = np.roll(polygons, -1, axis=1)
    cross = polygons[..., 0] * after[..., 1] - polygons[..., 1] * after[..., 0]
    return 0.5 * np.abs(cross.sum(axis=1))


def bev_intersection_paired(a: ArrayLike, b: ArrayLike) -> Array:
    """Overlap area (P,) in m² of the footprints of boxes a (P, 7) and b (P, 7), pair by pair."""
    return _bev_intersection(_as_boxes(a), _as_boxes(b))


def _bev_intersection(a: Array, b: Array) -> Array:
    out = np.zeros(len(a))
    reach = 0.5 * (np.hypot(a[:, LENGTH], a[:, WIDTH]) + np.hypot(b[:, LENGTH], b[:, WIDTH]))
    near = np.hypot(*(a[:, XY] - b[:, XY]).T) < reach
    if not near.any():
        return out
    a, b = a[near], b[near]
    # In a's own frame a is axis-aligned, so that the four half-planes are exact.
    c, s = np.cos(a[:, YAW]), np.sin(a[:, YAW])
    world = footprints(b) - a[:, None, XY]
    polygon = np.stack(
        [
            c[:, None] * world[..., 0] + s[:, None] * world[..., 1],
            -s[:, None] * world[..., 0] + c[:, None] * world[..., 1],
        ],
        axis=-1,
    )
    for axis, half in ((0, 0.5 * a[:, LENGTH]), (1, 0.5 * a[:, WIDTH])):
        for sign in (1.0, -1.0):
            normal = np.zeros((len(a), 2))
            normal[:, axis] = sign
            polygon = _clip_convex(polygon, normal, half)
    out[near] = _area(polygon)
    return out


def bev_iou_paired(a: ArrayLike, b: ArrayLike) -> Array:
    """Bird's-eye-view IoU (P,) of boxes a (P, 7) and b (P, 7), pair by pair."""
    first, second = _as_boxes(a), _as_boxes(b)
    overlap = _bev_intersection(first, second)
    return overlap / (first[:, LENGTH] * first[:, WIDTH] + second[:, LENGTH] * second[:, WIDTH] - overlap)


def iou_3d_paired(a: ArrayLike, b: ArrayLike) -> Array:
    """Volume IoU (P,) of upright boxes a (P, 7) and b (P, 7), pair by pair."""
    first, second = _as_boxes(a), _as_boxes(b)
    top = np.minimum(first[:, Z] + first[:, HEIGHT] / 2, second[:, Z] + second[:, HEIGHT] / 2)
    bottom = np.maximum(first[:, Z] - first[:, HEIGHT] / 2, second[:, Z] - second[:, HEIGHT] / 2)
    overlap = _bev_intersection(first, second) * np.maximum(top - bottom, 0.0)
    return overlap / (first[:, SIZE].prod(axis=1) + second[:, SIZE].prod(axis=1) - overlap)


def bev_iou(a: ArrayLike, b: ArrayLike) -> Array:
    """Bird's-eye-view IoU (N, M) of every box of a (N, 7) with every box of b (M, 7)."""
    first, second = _as_boxes(a), _as_boxes(b)
    pairs = np.repeat(first, len(second), axis=0), np.tile(second, (len(first), 1))
    return bev_iou_paired(*pairs).reshape(len(first), len(second))
