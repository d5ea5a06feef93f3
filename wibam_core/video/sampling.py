"""Common instants of several recordings: multiples of the sampling period on the reference clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]

_NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class Span:
    """Time from the first to the last frame of a recording, reference clock."""

    first_ns: int
    last_ns: int

    def __post_init__(self) -> None:
        if self.last_ns < self.first_ns:
            raise ValueError(f"a span cannot end ({self.last_ns} ns) before it begins ({self.first_ns} ns)")


def period_ns(rate_hz: float) -> Fraction:
    """The exact sampling period: 12.5 Hz is 80,000,000 ns, 30 Hz a third of 100,000,000."""
    return _NS_PER_S / Fraction(rate_hz).limit_denominator(100_000)


def multiples_within(span: Span, rate_hz: float) -> IntArray:
    """All multiples of the period, rounded to ns, from the first to the last frame, (N,) ascending."""
    period = period_ns(rate_hz)
    first = -((-span.first_ns) // period)
    last = span.last_ns // period
    return np.array([round(k * period) for k in range(int(first), int(last) + 1)], dtype=np.int64)


def common_instants(spans: Mapping[str, Span], rate_hz: float) -> IntArray:
    """Instants (N,) that at least two recordings span; all of its own where there is only one recording."""
    if not spans:
        return np.empty(0, dtype=np.int64)
    # one by one: two clocks may be years apart
    instants = np.unique(np.concatenate([multiples_within(span, rate_hz) for span in spans.values()]))
    firsts = np.array([[s.first_ns] for s in spans.values()])
    lasts = np.array([[s.last_ns] for s in spans.values()])
    covered = ((instants >= firsts) & (instants <= lasts)).sum(axis=0)
    return instants[covered >= min(2, len(spans))]


def overlap_s(spans: Mapping[str, Span]) -> float:
    """Longest stretch that two recordings share (s); that of the only one where there is one."""
    if len(spans) == 1:
        (only,) = spans.values()
        return (only.last_ns - only.first_ns) / _NS_PER_S
    every = list(spans.values())
    shared = [
        min(a.last_ns, b.last_ns) - max(a.first_ns, b.first_ns) for i, a in enumerate(every) for b in every[i + 1 :]
    ]
    return max(0, *shared) / _NS_PER_S if shared else 0.0


def nearest_times(times_ns: IntArray, targets_ns: IntArray, tolerance_ns: int | IntArray) -> list[int | None]:
    """For each target the nearest time, the earlier of two equally near; None where none is within the tolerance.

    Args:
        times_ns: (N,) ascending.
        targets_ns: (M,).
        tolerance_ns: largest distance; one, or (M,).
    """
    if not len(times_ns):
        return [None] * len(targets_ns)
    after = np.clip(np.searchsorted(times_ns, targets_ns), 0, len(times_ns) - 1)
    before = np.maximum(after - 1, 0)
    earlier = targets_ns - times_ns[before] <= times_ns[after] - targets_ns
    nearest = times_ns[np.where(earlier, before, after)]
    near = np.abs(nearest - targets_ns) <= tolerance_ns
    return [time if kept else None for time, kept in zip(nearest.tolist(), near.tolist(), strict=True)]


def nearer_times(times_ns: IntArray, target_ns: int, found_ns: int | None, tolerance_ns: int) -> list[int]:
    """The times that `nearest_times` would have preferred to what was found for a target.

    Args:
        times_ns: (N,) ascending.
        target_ns: the target.
        found_ns: one of the times; None: nothing was found within the tolerance.
        tolerance_ns: largest distance.
    """
    reach = tolerance_ns if found_ns is None else abs(found_ns - target_ns)
    within = times_ns[
        np.searchsorted(times_ns, target_ns - reach) : np.searchsorted(times_ns, target_ns + reach, "right")
    ]
    return [
        time
        for time in within.tolist()
        if found_ns is None or (abs(time - target_ns), time) < (abs(found_ns - target_ns), found_ns)
    ]
