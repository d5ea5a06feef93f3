"""Least median of squares: a fit that a few wrong clicks cannot spoil (Rousseeuw 1984)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Model = TypeVar("Model")

#: Fewer points than this cannot outvote a wrong one.
MIN_POINTS = 6
#: Random subsets of points that are tried, unless said.
_TRIALS = 200
#: Clicks closer than this to the fit are never taken for wrong.
_SMALLEST_PX = 3.0
#: Clicks farther than this many robust standard deviations from the fit are wrong.
_SIGMAS = 3.5


def find_inliers(
    count: int,
    sample: int,
    fit: Callable[[NDArray[np.int64]], list[Model]],
    errors_px: Callable[[Model], Array],
    seed: int = 0,
    trials: int = _TRIALS,
) -> NDArray[np.bool_]:
    """Which of ``count`` points agree with the model that has the smallest median error.

    Args:
        count: points in all.
        sample: points that fix a model.
        fit: models through the points of some indices; none where they are degenerate.
        errors_px: (count,) error of every point under a model, px.
        seed: of the random subsets.
        trials: how many of these.

    Returns:
        (count,) mask; all true with fewer than `MIN_POINTS` points, or where no subset gives a model.
    """
    everything = np.ones(count, dtype=bool)
    if count < MIN_POINTS:
        return everything
    if any((errors_px(model) <= _SMALLEST_PX).all() for model in fit(np.arange(count))):
        return everything
    rng = np.random.default_rng(seed)
    best, best_median = None, np.inf
    for _ in range(trials):
        for model in fit(np.sort(rng.choice(count, size=sample, replace=False))):
            errors = errors_px(model)
            median = float(np.median(errors))
            if median < best_median:
                best, best_median = errors, median
    if best is None:
        return everything
    sigma = 1.4826 * (1.0 + 5.0 / max(count - sample, 1)) * best_median
    return np.asarray(best <= max(_SIGMAS * sigma, _SMALLEST_PX))
