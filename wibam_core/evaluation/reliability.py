"""Are the stated uncertainties right? Standard deviations against the errors that were made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.metrics import CalibrationError, Coverage, Reliability, SdBin
from wibam_core.evaluation.uncertainty import GROUPS, laplace_quantile, normal_quantile, scale_factor

Array = NDArray[np.float64]

#: Shares of the errors that an interval is to hold.
LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
#: Bins of the stated standard deviation, equally full, and the fewest errors that one may hold.
_BINS, _LEAST = 8, 25


def reliability(errors: Array, sd: Array) -> dict[str, Reliability]:
    """By kind of number (`GROUPS`): do intervals hold the share of the errors that they should, and where not?

    Args:
        errors: (N, 7) predicted less true boxes.
        sd: (N, 7) stated standard deviations; NaN where there is none.
    """
    return {name: _of_group(errors[:, of].ravel(), sd[:, of].ravel()) for name, of in GROUPS.items()}


def _of_group(errors: Array, sd: Array) -> Reliability:
    known = np.isfinite(errors) & (sd > 0)
    errors, sd = np.abs(errors[known]), sd[known]
    if not len(errors):
        return Reliability(count=0)
    ratio = errors / sd
    levels = np.array(LEVELS)
    laplace = np.array([np.mean(ratio <= laplace_quantile(level)) for level in LEVELS])
    normal = np.array([np.mean(ratio <= normal_quantile(level)) for level in LEVELS])
    return Reliability(
        count=len(errors),
        scale_factor=scale_factor(errors, sd),
        coverage=Coverage(level=list(LEVELS), laplace=laplace.tolist(), normal=normal.tolist()),
        calibration_error=CalibrationError(
            laplace=float(np.abs(laplace - levels).mean()), normal=float(np.abs(normal - levels).mean())
        ),
        bins=tuple(_bins(errors, sd)),
    )


def _bins(errors: Array, sd: Array) -> list[SdBin]:
    """Bins of equally many stated standard deviations, each with their and the errors' root mean squares."""
    count = int(np.clip(len(errors) // _LEAST, 1, _BINS))
    return [
        SdBin(
            sd=float(np.sqrt(np.mean(sd[rows] ** 2))),
            rms=float(np.sqrt(np.mean(errors[rows] ** 2))),
            median=float(np.median(errors[rows])),
            count=len(rows),
        )
        for rows in np.array_split(np.argsort(sd, kind="stable"), count)
    ]
