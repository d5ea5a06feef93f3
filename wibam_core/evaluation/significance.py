"""Is one detector better than another, or is that chance?

The published Z-test takes every box for an independent sample. A vehicle is seen dozens of times, with nearly the
same error each time, so that the test is far too sure; the bootstrap draws whole vehicles instead. Of a few vehicles
it, too, is too sure: of one, all draws are alike. Where neither detector is better, all of n vehicles still change in
the same direction once in 2^(n-1) times (the sign test): no p below that is told, and nothing at all of fewer vehicles
than `MIN_VEHICLES`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.base import finite
from wibam_core.documents.metrics import Significance
from wibam_core.evaluation.evaluate import Evaluation
from wibam_core.evaluation.metrics import METRICS

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

DRAWS = 2000
#: Fewest of which a p below 0.05 can be told: five all change in the same direction by chance once in 16 times.
MIN_VEHICLES = 6


@dataclass(frozen=True)
class ZTest:
    """Two-sided Z-test of a difference of means."""

    z: float
    p: float


@dataclass(frozen=True)
class Bootstrap:
    """Difference of means with its 95 % interval, and the two-sided p that it is 0, by resampling vehicles.

    ``vehicles`` is how many there are, of that detector that has fewer; below `MIN_VEHICLES` interval and p are NaN.
    """

    difference: float
    low: float
    high: float
    p: float
    vehicles: int


def z_test(before: Array, after: Array) -> ZTest:
    """Z-test of the mean of ``after`` (M,) against that of ``before`` (N,); NaN below two values each."""
    if min(len(before), len(after)) < 2:
        return ZTest(math.nan, math.nan)
    spread = math.sqrt(float(before.var(ddof=1)) / len(before) + float(after.var(ddof=1)) / len(after))
    difference = float(after.mean() - before.mean())
    if spread == 0:
        return ZTest(math.copysign(math.inf, difference), 0.0) if difference else ZTest(0.0, 1.0)
    z = difference / spread
    return ZTest(z, math.erfc(abs(z) / math.sqrt(2)))


def bootstrap_by_vehicle(
    before: Array, before_ids: Indices, after: Array, after_ids: Indices, *, seed: int = 0, draws: int = DRAWS
) -> Bootstrap:
    """Difference of the means of ``after`` (M,) and ``before`` (N,) values, drawing vehicles with replacement.

    Args:
        before: values of one detector.
        before_ids: vehicle of each value of ``before``.
        after: values of the other detector.
        after_ids: vehicle of each value of ``after``.
        seed: of the draws.
        draws: how many.
    """
    if not len(before) or not len(after):
        return Bootstrap(math.nan, math.nan, math.nan, math.nan, 0)
    difference = float(after.mean() - before.mean())
    fewer = min(len(np.unique(before_ids)), len(np.unique(after_ids)))
    if fewer < MIN_VEHICLES:
        return Bootstrap(difference, math.nan, math.nan, math.nan, fewer)
    vehicles, index = np.unique(np.concatenate([before_ids, after_ids]), return_inverse=True)
    n = len(vehicles)
    of_before, of_after = index[: len(before)], index[len(before) :]
    times = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=draws).astype(np.float64)

    def means(values: Array, of: Indices) -> Array:
        with np.errstate(invalid="ignore"):
            return (times @ np.bincount(of, weights=values, minlength=n)) / (times @ np.bincount(of, minlength=n))

    differences = means(after, of_after) - means(before, of_before)
    differences = differences[np.isfinite(differences)]
    low, high = np.quantile(differences, [0.025, 0.975])
    tail = min(float(np.mean(differences <= 0)), float(np.mean(differences >= 0)))
    p = min(1.0, max(2 * max(tail, 1 / (len(differences) + 1)), 2.0 ** (1 - fewer)))
    return Bootstrap(difference, float(low), float(high), p, fewer)


def both_tests(before: Array, before_ids: Indices, after: Array, after_ids: Indices, *, seed: int = 0) -> Significance:
    """Both tests of one figure; arguments as of `bootstrap_by_vehicle`."""
    test = z_test(before, after)
    drawn = bootstrap_by_vehicle(before, before_ids, after, after_ids, seed=seed)
    return Significance(
        z=finite(test.z),
        p_z=finite(test.p),
        difference=finite(drawn.difference),
        low=finite(drawn.low),
        high=finite(drawn.high),
        p_bootstrap=finite(drawn.p),
        vehicles=drawn.vehicles,
    )


def significance(before: Evaluation, after: Evaluation, *, seed: int = 0) -> dict[str, Significance]:
    """Both tests, by metric."""
    result = {}
    for name in METRICS:
        first, second = getattr(before.metrics, name), getattr(after.metrics, name)
        in_first, in_second = np.isfinite(first), np.isfinite(second)
        result[name] = both_tests(
            first[in_first],
            before.matched.vehicle_ids[in_first],
            second[in_second],
            after.matched.vehicle_ids[in_second],
            seed=seed,
        )
    return result
