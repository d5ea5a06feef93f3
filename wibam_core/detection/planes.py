"""Images as networks take them: planes of float32, one a channel."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

FloatPlanes = NDArray[np.float32]


def shares_of(planes: Sequence[NDArray[np.uint8]], highest: float = 1.0) -> FloatPlanes:
    """Planes (C, H, W) float32 of C planes (H, W) uint8: 0 stays 0, and 255 becomes ``highest``.

    There are 256 values only, each of which is divided once and then looked up.
    """
    shares = np.empty((len(planes), *planes[0].shape), np.float32)
    for values, plane in zip(shares, planes, strict=True):
        cv2.LUT(plane, _table(highest), dst=values)
    return shares


@lru_cache(maxsize=4)
def _table(highest: float) -> FloatPlanes:
    return (np.arange(256) / (255.0 / highest)).astype(np.float32)
