"""Stretches in which a recording shows one and the same picture: a frozen camera, a covered lens, a photograph."""

from __future__ import annotations

import numpy as np
from av.video.frame import VideoFrame
from numpy.typing import NDArray

#: Of a picture every so many pixels are compared. What is still differs by less than this at the mean, and hardly
#: anywhere by more than that, grey levels: so much do encoders make of one picture; sensors make more noise.
_STEP = 4
_MEAN, _MOST, _MOST_SHARE = 0.3, 3, 0.001
#: Pictures that are alike, one after another: fewer say nothing.
_FEWEST = 3


class Stills:
    """Compares pictures that are looked at now and then with the one before."""

    def __init__(self) -> None:
        self._grey: NDArray[np.int16] | None = None
        self._run: list[int] = []
        self._longest: tuple[int, int] | None = None

    def add(self, number: int, frame: VideoFrame) -> None:
        """The next picture, known by its number."""
        grey = frame.reformat(format="gray").to_ndarray()[::_STEP, ::_STEP].astype(np.int16)
        if self._grey is None or not _alike(grey, self._grey):
            self._run = []
            self._grey = grey  # what changes slowly is compared with the first of a stretch
        self._run.append(number)
        first, last = self._longest or (0, 0)
        if len(self._run) >= _FEWEST and number - self._run[0] > last - first:
            self._longest = (self._run[0], number)

    @property
    def longest(self) -> tuple[int, int] | None:
        """Numbers of the first and the last picture of the longest stretch; None where there is none."""
        return self._longest


def _alike(one: NDArray[np.int16], other: NDArray[np.int16]) -> bool:
    if one.shape != other.shape:
        return False
    apart = np.abs(one - other)
    return bool(apart.mean() < _MEAN and (apart > _MOST).mean() < _MOST_SHARE)
