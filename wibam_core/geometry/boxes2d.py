"""Boxes in the image, xyxy in px: areas, the image's border, overlaps, and what was found twice.

Pixel (0, 0) is the centre of the top-left pixel, so that an image covers u in [−0.5, width − 0.5).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: No more candidates than this enter `non_maximum_suppression`: the best ones.
_MAX_CANDIDATES = 1000


def sides_px(boxes: Array) -> Array:
    """Width and height (..., 2) of boxes (..., 4); negative where a box is inside out."""
    return np.asarray(boxes[..., 2:] - boxes[..., :2])


def areas_px2(boxes: Array) -> Array:
    """Areas (...) of boxes (..., 4); 0 where a box is inside out."""
    return np.asarray(np.clip(sides_px(boxes), 0.0, None).prod(axis=-1))


def clipped_to_image(boxes: Array, width_px: int, height_px: int) -> Array:
    """Boxes (..., 4) cut at the image's border; what lies beyond it becomes a box without area on it."""
    return np.clip(boxes, -0.5, np.array([width_px, height_px] * 2) - 0.5)


def intersections_px2(a: Array, b: Array) -> Array:
    """Areas (N, M) that boxes a (N, 4) share with boxes b (M, 4)."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    return np.asarray(np.clip(high - low, 0.0, None).prod(axis=-1))


def image_iou(a: ArrayLike, b: ArrayLike) -> Array:
    """Intersection over union (N, M) of boxes a (N, 4) and b (M, 4); 0 with boxes without area, or that are NaN."""
    first = np.asarray(a, dtype=np.float64).reshape(-1, 4)
    second = np.asarray(b, dtype=np.float64).reshape(-1, 4)
    overlap = intersections_px2(first, second)
    union = areas_px2(first)[:, None] + areas_px2(second)[None, :] - overlap
    return np.divide(overlap, union, out=np.zeros_like(overlap), where=union > 0)


def distinct(boxes: Array, max_iou: float) -> NDArray[np.int64]:
    """Greedy non-maximum suppression of boxes (N, 4) that come best first.

    Args:
        boxes: of one image, whatever their classes: a van is not also a truck.
        max_iou: a box that overlaps a better kept one by more is dropped.

    Returns:
        (K,) indices of the kept boxes, ascending.
    """
    overlaps = image_iou(boxes, boxes) > max_iou
    kept = np.ones(len(boxes), dtype=bool)
    for index in range(len(boxes)):
        if kept[index]:
            kept[index + 1 :] &= ~overlaps[index, index + 1 :]
    return np.flatnonzero(kept)


def non_maximum_suppression(boxes: Array, scores: Array, max_iou: float) -> NDArray[np.int64]:
    """`distinct` boxes (N, 4) of the 1000 with the best scores (N,).

    Returns:
        (K,) indices of the kept boxes, best first; of equal scores the first comes first.
    """
    order = np.argsort(-scores, kind="stable")[:_MAX_CANDIDATES]
    return np.asarray(order[distinct(boxes[order], max_iou)])
