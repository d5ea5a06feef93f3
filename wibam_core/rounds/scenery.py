"""Boxes on scenery: on what looks the same all the time, as a house front does that a detector takes for a truck.

A camera's usual view is the median of the frames that show its background, whatever a detector finds in them. What
differs from it in one of them has changed. A box in which hardly anything has ever changed, nor differs in its own
frame, lies on scenery, or on a vehicle that stands there all the time. Which of the two, other cameras tell: who stands
there is seen by them, too, most of the time, whereas boxes on scenery meet now and then (`rounds.settled`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.detection.background import still_background
from wibam_core.detection.boxes import FloatArray, Image
from wibam_core.detection.moving import Stillness
from wibam_core.rounds.world import Detected

#: Something passes by in front of scenery, or its box is larger than it: this share of the box may have changed.
_CHANGED_SHARE = 0.2


class ToldApart(NamedTuple):
    """What a detector found in all frames, px of the recording.

    Attributes:
        trusted: boxes that lie on no scenery. on_scenery: all others.
    """

    trusted: Detected
    on_scenery: Detected

    @classmethod
    def unasked(cls, detected: Detected) -> ToldApart:
        """As long as nobody looked for scenery."""
        return cls(detected, {frame: boxes.where(np.empty(0, dtype=np.int64)) for frame, boxes in detected.items()})


@dataclass(frozen=True, eq=False)
class Scenery:
    """What a fixed camera always shows.

    Attributes:
        usual: its median view, and by how much it differs from that as it is.
        changed: (h, w) uint8, shrunk as that is: 255 where it has differed by more, else 0.
    """

    usual: Stillness
    changed: Image

    @classmethod
    def of(cls, images: Sequence[Image]) -> Scenery:
        """Of the images (H, W, 3) of one camera that show its background, at least one, evenly spread in time."""
        usual = Stillness.of(still_background(images, [np.empty((0, 4))] * len(images)), images)
        changed = np.zeros_like(usual.known)
        for image in images:
            changed |= usual.bodies(image)
        return cls(usual, changed)

    def holds(self, image: Image, boxes: FloatArray) -> NDArray[np.bool_]:
        """(N,) whether boxes (N, 4) xyxy, px, of an image (H, W, 3) of this camera lie on what never changes."""
        if not len(boxes):
            return np.zeros(0, dtype=bool)
        count = cv2.integral((self.changed | self.usual.bodies(image)) // 255)
        height, width = self.changed.shape
        left, top, right, bottom = np.rint(self.usual.shrunk_px(boxes)).astype(int).T
        left, top = left.clip(0, width - 1), top.clip(0, height - 1)
        right, bottom = right.clip(left, width - 1) + 1, bottom.clip(top, height - 1) + 1
        changed = count[bottom, right] - count[top, right] - count[bottom, left] + count[top, left]
        return np.asarray(changed < _CHANGED_SHARE * (right - left) * (bottom - top))


def among(boxes: FloatArray, others: FloatArray) -> NDArray[np.bool_]:
    """(N,) which of boxes (N, 4) are among others (M, 4), to the bit."""
    return np.asarray((boxes[:, None] == others).all(axis=-1).any(axis=1))
