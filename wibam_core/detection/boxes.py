"""What all detectors share: the shape of their answer, and which of what they find is kept."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.boxes2d import clipped_to_image, non_maximum_suppression, sides_px

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Image = NDArray[np.uint8]

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

    def where(self, rows: IntArray) -> Found:
        """The selected boxes, in the order of ``rows``."""
        return Found(self.boxes[rows], self.scores[rows], self.classes[rows])


def select(boxes: FloatArray, scores: FloatArray, classes: IntArray, size: tuple[int, int], max_iou: float) -> Found:
    """Clip boxes to the image of ``size`` (width, height) px, drop empty ones and duplicates."""
    width, height = size
    clipped = clipped_to_image(boxes, width, height)
    sound = (sides_px(clipped) >= _MIN_SIDE_PX).all(axis=1)
    clipped, scores, classes = clipped[sound], scores[sound], classes[sound]
    kept = non_maximum_suppression(clipped, scores, max_iou)
    return Found(clipped, scores, classes).where(kept)
