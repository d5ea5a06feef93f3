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
