"""What a fixed camera shows where no vehicle is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from wibam_core.detection.boxes import FloatArray, Image, IntArray
from wibam_core.video.sampling import nearest_times

#: A box hides more than itself, since boxes are never exact and edges are blurred: on each side this share of its width
#: or height, and so many px.
_MARGIN_SHARE, _MARGIN_PX = 0.08, 2.0
#: A pixel is known if it was free in so many images.
_FEWEST = 4
#: What was surely seen without anybody in so many images decides, whatever the others show.
FEWEST_UNCOVERED = 2
#: Value of unknown pixels.
UNKNOWN = 128
#: A background is made of so many frames, and a recording has at least so many that may show it: one every few seconds.
_FRAMES, _SPACING_S = 32, 2.0
#: Rows that are sorted at one time, so that memory stays small.
_STRIP = 32


class BackgroundFrames:
    """Which frames of a fixed camera show its background at which time.

    That follows from its recording alone, so that it stays as it is whatever instants are looked at: the frames that
    are nearest to evenly spaced times of its own clock.

    Args:
        times_ns: (N,) times of all frames of the recording on its own clock, ascending.
        stored_ns: (M,) those of the frames that are at hand, ascending: with the nearest to each of `targets_ns` that
            can be decoded, any others.
        block_s: about how long one background lasts. All last equally long.
    """

    def __init__(self, times_ns: IntArray, stored_ns: IntArray, block_s: float) -> None:
        self._first_ns, self._duration_ns = int(times_ns[0]), max(int(times_ns[-1] - times_ns[0]), 1)
        self._blocks = max(1, round(self._duration_ns * 1e-9 / block_s))
        targets_ns, tolerance_ns = self.targets_ns(times_ns)
        self._of_block: dict[int, list[int]] = {}
        for local_ns in nearest_times(stored_ns, targets_ns, tolerance_ns):
            if local_ns is not None:
                of_block = self._of_block.setdefault(self.block(local_ns), [])
                if local_ns not in of_block[-1:]:
                    of_block.append(local_ns)

    @staticmethod
    def targets_ns(times_ns: IntArray) -> tuple[IntArray, int]:
        """The evenly spaced times (K,) of a recording, and how far from one of them a frame may lie (ns).

        Args:
            times_ns: (N,) times of all its frames on its own clock, ascending.
        """
        duration_ns = float(times_ns[-1] - times_ns[0])
        count = max(_FRAMES, math.ceil(duration_ns * 1e-9 / _SPACING_S))
        spacing_ns = duration_ns / count
        return times_ns[0] + np.rint((np.arange(count) + 0.5) * spacing_ns).astype(np.int64), round(spacing_ns / 2)

    def block(self, local_ns: int) -> int:
        """Number of the background that is shown at a time of the recording."""
        return min((local_ns - self._first_ns) * self._blocks // self._duration_ns, self._blocks - 1)

    def of_block(self, block: int) -> list[int]:
        """Times of the frames that show a background, ascending, evenly chosen among those there are."""
        there = self._of_block.get(block, [])
        places = np.linspace(0, len(there) - 1, min(len(there), _FRAMES)).round().astype(int)
        return [there[place] for place in places.tolist()]


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


def still_background(
    images: Sequence[Image], boxes: Sequence[FloatArray], uncovered: Sequence[Image] | None = None
) -> StillBackground:
    """Median over the images of what lies outside of the boxes.

    A plain median shows the queue at a red light as background, which stands there for half of the time.

    Args:
        images: (H, W, 3) uint8 BGR of one camera, up to some minutes around the time of interest.
        boxes: of each image, (N, 4) xyxy px.
        uncovered: of each image, (H, W) uint8 above 0 where it surely shows the background: where two do, the others
            do not count.
    """
    stack = np.empty((*images[0].shape, len(images)), np.uint8)
    for number, image in enumerate(images):
        stack[..., number] = image
    free = np.ones((*stack.shape[:2], len(images)), bool)
    for number, found in enumerate(boxes):
        free[..., number] = outside(found, (images[0].shape[0], images[0].shape[1]))
    fewest = np.full(stack.shape[:2], min(_FEWEST, len(images)))
    if uncovered is not None:
        sure = np.stack(uncovered, axis=-1) > 0
        decided = sure.sum(axis=-1) >= FEWEST_UNCOVERED
        free[decided] = sure[decided]
        fewest[decided] = FEWEST_UNCOVERED
    count = free.sum(axis=-1)
    image = np.empty(stack.shape[:3], np.uint8)
    for top in range(0, len(stack), _STRIP):
        rows = slice(top, top + _STRIP)
        # what is hidden sorts to the end, behind the median of the rest
        values = np.sort(np.where(free[rows, :, None], stack[rows], np.uint8(255)), axis=-1)
        middle = np.maximum(count[rows] - 1, 0)[..., None, None] // 2
        image[rows] = np.take_along_axis(values, middle, axis=-1)[..., 0]
    known = count >= fewest
    image[~known] = UNKNOWN
    return StillBackground(image, np.where(known, np.uint8(255), np.uint8(0)))


def outside(boxes: FloatArray, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W) of an image of that shape: where none of its boxes (N, 4) xyxy px hides the background."""
    free = np.ones(shape, bool)
    margin = _MARGIN_PX + _MARGIN_SHARE * (boxes[:, 2:] - boxes[:, :2])
    low = np.floor(np.maximum(boxes[:, :2] - margin + 0.5, 0)).astype(int)
    high = np.ceil(boxes[:, 2:] + margin + 0.5).astype(int)
    for (x0, y0), (x1, y1) in zip(low, high, strict=True):
        free[y0:y1, x0:x1] = False
    return free
