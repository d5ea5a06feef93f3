"""Polygons in a plane."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def inside_any(points: Array, polygons: Iterable[Array]) -> NDArray[np.bool_]:
    """(N,) whether points (N, 2) lie inside one of several polygons (K, 2), by the even-odd rule."""
    found = np.zeros(len(points), bool)
    x, y = np.asarray(points, dtype=np.float64).reshape(-1, 2).T[:, :, None]
    for polygon in polygons:
        start = np.asarray(polygon, dtype=np.float64).reshape(-1, 2)
        x0, y0 = start.T
        x1, y1 = np.roll(start, -1, axis=0).T
        straddles = (y0 > y) != (y1 > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = x0 + (y - y0) * (x1 - x0) / (y1 - y0)
        found |= (straddles & (x < crossing)).sum(axis=1) % 2 == 1
    return found
