"""How far a fit can be trusted, as one number."""

from __future__ import annotations

import numpy as np

from wibam_core.geometry.box3d import WIDTH, X, Y
from wibam_core.scene import FloatArray


def confidence(
    residual: FloatArray, views: FloatArray, sd: FloatArray, boxes: FloatArray, max_residual: float
) -> FloatArray:
    """(N,) in [0, 1]: near the overlap with the true box that may be expected.

    On simulated sites the uncertainty of the position ranks fits best; the residual adds to it, and so does, a little,
    that few views could contradict each other.

    Args:
        residual: (N,) mean 1 − GIoU.
        views: (N,) number of views.
        sd: (N, 6) of x, y, log sizes, yaw.
        boxes: (N, 7).
        max_residual: largest residual that is kept.
    """
    place = np.exp(-2.0 * np.hypot(sd[:, X], sd[:, Y]) / boxes[:, WIDTH])
    fit = np.clip(1.0 - 0.25 * (residual / max_residual) ** 2, 0.0, 1.0)
    contradiction = 1.0 - 0.1 * 0.5 ** (np.asarray(views, dtype=np.float64) - 1.0)
    return np.asarray(place * fit * contradiction)
