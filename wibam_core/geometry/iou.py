"""Exact overlaps of upright boxes: footprints in bird's-eye view, and volumes. Image boxes: see `boxes2d`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.geometry.box3d import HEIGHT, LENGTH, SIZE, WIDTH, XY, YAW, Z

Array = NDArray[np.float64]

#: Along (0) and across (1) the box, of its footprint's corners counter-clockwise; and the corner that follows each.
_CORNER_SIGNS = np.array([[1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0]])
_NEXT = [1, 2, 3, 0]


def _as_boxes(boxes: ArrayLike) -> Array:
    return np.asarray(boxes, dtype=np.float64).reshape(-1, 7)


def bev_intersection_paired(a: ArrayLike, b: ArrayLike) -> Array:
    """Overlap area (P,) in m² of the footprints of boxes a (P, 7) and b (P, 7), pair by pair."""
    return _bev_intersection(_as_boxes(a), _as_boxes(b))


def _bev_intersection(a: Array, b: Array) -> Array:
    """Overlap area (P,) of the footprints of boxes a (P, 7) and b (P, 7).

    In a's own frame a is [−h_x, h_x] × [−h_y, h_y]. There the overlap at an x of a is as high as b's upper side lies
    above b's lower one, both clamped to ±h_y, and its area is the integral of that: the sum, over b's edges in turn, of
    the integrals of their clamped heights. This changes steadily with the boxes, so that edges that coincide need no
    care.
    """
    out = np.zeros(len(a))
    reach = 0.5 * (np.hypot(a[:, LENGTH], a[:, WIDTH]) + np.hypot(b[:, LENGTH], b[:, WIDTH]))
    near = np.hypot(*(a[:, XY] - b[:, XY]).T) < reach
    if near.any():
        out[near] = _near_intersection(a[near], b[near])
    return out


def _near_intersection(a: Array, b: Array) -> Array:
    x, y = _corners_in_frame(a, b)
    half_x, half_y = 0.5 * a[:, LENGTH], 0.5 * a[:, WIDTH]
    x_next, y_next = x[_NEXT], y[_NEXT]
    begin, end = np.clip(x, -half_x, half_x), np.clip(x_next, -half_x, half_x)
    along = x_next - x
    begin_share, end_share = (
        np.divide(at - x, along, out=np.zeros_like(along), where=along != 0) for at in (begin, end)
    )
    y_begin, y_end = y + begin_share * (y_next - y), y + end_share * (y_next - y)
    low, high = np.clip(y_begin, -half_y, half_y), np.clip(y_end, -half_y, half_y)
    middle = low + high
    rise = y_end - y_begin
    within = np.divide(high - low, rise, out=np.zeros_like(rise), where=rise != 0)
    # The mean of a clamped linear function: where one end is beyond the clamp, more of the edge lies at that end.
    mean = 0.5 * (middle + within * (y_begin + y_end - middle))
    return np.maximum(-((end - begin) * mean).sum(axis=0), 0.0)


def _corners_in_frame(a: Array, b: Array) -> tuple[Array, Array]:
    """x and y (4, P), in the frames of boxes a (P, 7), of the footprints of boxes b (P, 7), counter-clockwise."""
    c, s = np.cos(a[:, YAW]), np.sin(a[:, YAW])
    dx, dy = (b[:, XY] - a[:, XY]).T
    turn = b[:, YAW] - a[:, YAW]
    turned = np.array([np.cos(turn), np.sin(turn)])
    forward, left = 0.5 * b[:, LENGTH] * turned, 0.5 * b[:, WIDTH] * turned
    x, y = c * dx + s * dy, c * dy - s * dx
    along, across = _CORNER_SIGNS[..., None]
    return x + along * forward[0] - across * left[1], y + along * forward[1] + across * left[0]


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
