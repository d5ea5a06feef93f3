"""Boxes in other formats' orders and origins; ours are xyxy, with the centre of the first pixel at (0, 0)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: From coordinates whose origin is the centre of the first pixel to those where it is the image's corner.
CORNER_PX = 0.5


def corner_xywh(boxes: ArrayLike) -> Array:
    """Boxes (N, 4) xyxy as x, y, width, height (N, 4) with the origin at the corner of the image."""
    b = np.asarray(boxes, dtype=np.float64).reshape(-1, 4)
    return np.concatenate([b[:, :2] + CORNER_PX, b[:, 2:] - b[:, :2]], axis=1)


def from_corner_xywh(boxes: ArrayLike) -> Array:
    """The inverse of `corner_xywh`, but for rounding: (N, 4) to (N, 4)."""
    b = np.asarray(boxes, dtype=np.float64).reshape(-1, 4)
    low = b[:, :2] - CORNER_PX
    return np.concatenate([low, low + b[:, 2:]], axis=1)
