"""What a fixed camera shows where no vehicle is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from wibam_core.detection.boxes import FloatArray, Image

#: A box hides this share of its sides more on each side, since boxes are never exact and edges are blurred.
_MARGIN_SHARE, _MARGIN_PX = 0.08, 2.0
#: A pixel is known if it was free in so many images.
_FEWEST = 4
#: Value of unknown pixels.
UNKNOWN = 128
#: Rows that are sorted at one time, so that memory stays small.
_STRIP = 32


@dataclass(frozen=True, eq=False)
class StillBackground:
    """A camera's view without vehicles.

    Attributes:
        image: (H, W, 3) uint8 BGR, `UNKNOWN` where a vehicle always stood.
        known: (H, W) uint8, 255 where the background was seen, else 0.
    """

    image: Image
    known: Image

    @classmethod
    @lru_cache(maxsize=4)
    def unknown(cls, height: int, width: int) -> StillBackground:
        """Of a camera of which nothing is known."""
        return cls(np.full((height, width, 3), UNKNOWN, np.uint8), np.zeros((height, width), np.uint8))

    @cached_property
    def layers(self) -> Image:
        """(H, W, 4) uint8: image and known."""
        return np.dstack([self.image, self.known])


def still_background(images: Sequence[Image], boxes: Sequence[FloatArray]) -> StillBackground:
    """Median over the images of what lies outside of the boxes.

    A plain median shows the queue at a red light as background, which stands there for half of the time.

    Args:
        images: (H, W, 3) uint8 BGR of one camera, up to some minutes around the time of interest.
        boxes: of each image, (N, 4) xyxy px.
    """
    stack = np.empty((*images[0].shape, len(images)), np.uint8)
    for number, image in enumerate(images):
        stack[..., number] = image
    free = np.ones((*stack.shape[:2], len(images)), bool)
    for number, found in enumerate(boxes):
        margin = _MARGIN_PX + _MARGIN_SHARE * (found[:, 2:] - found[:, :2])
        low = np.floor(np.maximum(found[:, :2] - margin + 0.5, 0)).astype(int)
        high = np.ceil(found[:, 2:] + margin + 0.5).astype(int)
        for (x0, y0), (x1, y1) in zip(low, high, strict=True):
            free[y0:y1, x0:x1, number] = False
    count = free.sum(axis=-1)
    image = np.empty(stack.shape[:3], np.uint8)
    for top in range(0, len(stack), _STRIP):
        rows = slice(top, top + _STRIP)
        # what is hidden sorts to the end, behind the median of the rest
        values = np.sort(np.where(free[rows, :, None], stack[rows], np.uint8(255)), axis=-1)
        middle = np.maximum(count[rows] - 1, 0)[..., None, None] // 2
        image[rows] = np.take_along_axis(values, middle, axis=-1)[..., 0]
    known = count >= min(_FEWEST, len(images))
    image[~known] = UNKNOWN
    return StillBackground(image, np.where(known, np.uint8(255), np.uint8(0)))
