"""Are the stated uncertainties right? Standard deviations against the errors that were made."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wibam_core.evaluation.uncertainty import GROUPS, laplace_quantile, normal_quantile, scale_factor

Array = NDArray[np.float64]

#: Shares of the errors that an interval is to hold.
LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
#: Bins of the stated standard deviation, equally full, and the fewest errors that one may hold.
_BINS, _LEAST = 8, 25


def reliability(errors: Array, sd: Array) -> dict[str, Any]:
    """By kind of number (`GROUPS`), JSON types; a kind without a stated standard deviation has a count of 0 alone.

    Args:
        errors: (N, 7) predicted less true boxes.
        sd: (N, 7) stated standard deviations; NaN where there is none.

    Returns:
        For each kind ``count``; ``scale_factor``: what the standard deviations should be multiplied with;
        ``coverage``: ``{"level", "laplace", "normal"}``, the share of errors in the interval that should hold the
        share ``level`` of them, by either distribution; ``calibration_error``: the mean of their differences, by
        either; ``bins`` of the stated standard deviation with ``sd``: the root mean square of the stated, ``rms`` and
        ``median``: of the absolute errors, and ``count``.
    """
    return {name: _of_group(errors[:, of].ravel(), sd[:, of].ravel()) for name, of in GROUPS.items()}


def _of_group(errors: Array, sd: Array) -> dict[str, Any]:
    known = np.isfinite(errors) & (sd > 0)
    errors, sd = np.abs(errors[known]), sd[known]
    if not len(errors):
        return {"count": 0}
    ratio = errors / sd
    levels = np.array(LEVELS)
    laplace = np.array([np.mean(ratio <= laplace_quantile(level)) for level in LEVELS])
    normal = np.array([np.mean(ratio <= normal_quantile(level)) for level in LEVELS])
    return {
        "count": len(errors),
        "scale_factor": scale_factor(errors, sd),
        "coverage": {"level": list(LEVELS), "laplace": laplace.tolist(), "normal": normal.tolist()},
        "calibration_error": {
            "laplace": float(np.abs(laplace - levels).mean()),
            "normal": float(np.abs(normal - levels).mean()),
        },
        "bins": _bins(errors, sd),
    }


def _bins(errors: Array, sd: Array) -> list[dict[str, float]]:
    count = int(np.clip(len(errors) // _LEAST, 1, _BINS))
    return [
        {
            "sd": float(np.sqrt(np.mean(sd[rows] ** 2))),
            "rms": float(np.sqrt(np.mean(errors[rows] ** 2))),
            "median": float(np.median(errors[rows])),
            "count": len(rows),
        }
        for rows in np.array_split(np.argsort(sd, kind="stable"), count)
    ]
