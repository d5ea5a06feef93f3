"""What all detectors share: the shape of their answer, suppression of duplicates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Image = NDArray[np.uint8]

#: No more candidates than this enter the suppression: the best ones.
_MAX_CANDIDATES = 1000
#: Boxes narrower or lower than this inside the image are noise.
_MIN_SIDE_PX = 1.0


class Found(NamedTuple):
    """Boxes in one image, best first.

    Attributes:
        boxes: (N, 4) xyxy, px of the image given; (0, 0) is the centre of its first pixel.
        scores: (N,) in [0, 1].
        classes: (N,) indices into `wibam_core.road_users.CLASSES`.
    """

    boxes: FloatArray
    scores: FloatArray
    classes: IntArray


def pairwise_iou(a: FloatArray, b: FloatArray) -> FloatArray:
    """Intersection over union of xyxy boxes (N, 4) and (M, 4): (N, M). Boxes without area give 0."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    overlap = np.clip(high - low, 0.0, None).prod(axis=2)
    union = _areas(a)[:, None] + _areas(b)[None, :] - overlap
    return np.divide(overlap, union, out=np.zeros_like(overlap), where=union > 0)


def non_maximum_suppression(boxes: FloatArray, scores: FloatArray, max_iou: float) -> IntArray:
    """Greedy non-maximum suppression, whatever the classes: a van is not also a truck.

    Args:
        boxes: (N, 4) xyxy.
        scores: (N,).
        max_iou: a box that overlaps a better kept one by more is dropped.

    Returns:
        (K,) indices of the kept boxes, best first; of equal scores the first comes first.
    """
    order = np.argsort(-scores, kind="stable")[:_MAX_CANDIDATES]
    ranked = boxes[order]
    overlaps = pairwise_iou(ranked, ranked) > max_iou
    alive = np.ones(len(order), dtype=bool)
    for i in range(len(order)):
        if alive[i]:
            alive[i + 1 :] &= ~overlaps[i, i + 1 :]
    return order[alive]


def select(boxes: FloatArray, scores: FloatArray, classes: IntArray, size: tuple[int, int], max_iou: float) -> Found:
    """Clip boxes to the image of ``size`` (width, height) px, drop empty ones and duplicates."""
    width, height = size
    clipped = np.clip(boxes, -0.5, np.array([width, height, width, height]) - 0.5)
    sound = ((clipped[:, 2:] - clipped[:, :2]) >= _MIN_SIDE_PX).all(axis=1)
    clipped, scores, classes = clipped[sound], scores[sound], classes[sound]
    kept = non_maximum_suppression(clipped, scores, max_iou)
    return Found(clipped[kept], scores[kept], classes[kept])


def _areas(boxes: FloatArray) -> FloatArray:
    return np.clip(boxes[:, 2:] - boxes[:, :2], 0.0, None).prod(axis=1)
