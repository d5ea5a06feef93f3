"""Intervals of the measures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Interval:
    """90 % interval, in s; inf where no collision is foreseen."""

    low_s: float
    high_s: float

    @classmethod
    def of(cls, draws: Array) -> Interval:
        """From draws (K,) that may be inf; at least one."""
        low, high = np.quantile(draws, [0.05, 0.95], method="nearest") if len(draws) else (np.inf, np.inf)
        return cls(float(low), float(high))
