"""A detector on parts of an image as well: where road users are small, it sees them larger."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wibam_core.detection.boxes import Found, Image, IntArray, select
from wibam_core.detection.family import Detector
from wibam_core.road_users import RoadUserClass

#: Neighbouring tiles share this part of their sides: what the border of one cuts, the other shows whole.
_SHARED = 0.25
#: A box this near to the border of a tile within the image is cut by it, px.
_CUT_PX = 2.0


class TiledDetector:
    """Looks at the whole image and at ``count`` x ``count`` tiles of it; what is found twice counts once.

    Args:
        detector: what looks.
        count: tiles along each side.
        nms_iou: of two boxes that overlap more, the weaker is left out.
    """

    def __init__(self, detector: Detector, count: int, nms_iou: float) -> None:
        self._detector, self._count, self._nms_iou = detector, count, nms_iou

    @property
    def classes(self) -> tuple[RoadUserClass, ...]:
        """What it looks for."""
        return self._detector.classes

    def detect(self, image_bgr: Image) -> Found:
        """Road users in an image (H, W, 3) uint8, BGR, in its own pixels."""
        height, width = image_bgr.shape[:2]
        parts = [self._detector.detect(image_bgr)]
        for y0, y1 in spans(height, self._count):
            for x0, x1 in spans(width, self._count):
                seen = self._detector.detect(np.ascontiguousarray(image_bgr[y0:y1, x0:x1]))
                whole = seen.where(np.flatnonzero(~_cut(seen.boxes, (x0, y0, x1, y1), (width, height))))
                parts.append(Found(whole.boxes + np.array([x0, y0, x0, y0]), whole.scores, whole.classes))
        boxes, scores, classes = (np.concatenate(of) for of in zip(*parts, strict=True))
        return select(boxes, scores, _integers(classes), (width, height), self._nms_iou)


def spans(length_px: int, count: int) -> list[tuple[int, int]]:
    """First pixels of ``count`` tiles along a side, and their ends (exclusive): equally long, the first and the last
    at the image's borders."""
    if count == 1:
        return [(0, length_px)]
    size = min(round(length_px / (count - (count - 1) * _SHARED)), length_px)
    starts = np.rint(np.linspace(0, length_px - size, count)).astype(int)
    return [(int(start), int(start) + size) for start in starts]


def _cut(boxes: NDArray[np.float64], tile: tuple[int, int, int, int], size: tuple[int, int]) -> NDArray[np.bool_]:
    """(N,) whether a border of a tile that is none of the image cuts boxes (N, 4), px of the tile."""
    x0, y0, x1, y1 = tile
    width, height = size
    inner = np.array([x0 > 0, y0 > 0, x1 < width, y1 < height])
    ends = np.array([x1 - x0, y1 - y0]) - 1.0
    near = np.concatenate([boxes[:, :2] < _CUT_PX, boxes[:, 2:] > ends - _CUT_PX], axis=1)
    return np.asarray((near & inner).any(axis=1))


def _integers(values: NDArray) -> IntArray:
    return np.asarray(values, dtype=np.int64)
