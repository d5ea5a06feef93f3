"""Learning rates over the course of a training."""

from __future__ import annotations

import math
from dataclasses import dataclass

_WARM_UP_SHARE = 0.05

#: Howe et al. 2021: the rate is divided by 10 once the loss has not fallen by 0.001 for 4 epochs.
_PATIENCE_EPOCHS = 4
_TOLERANCE = 1e-3
_FACTOR = 0.1


@dataclass(frozen=True)
class CosineSchedule:
    """A short linear rise, then a cosine fall to 1 % over ``steps``."""

    peak: float
    steps: int

    def rate(self, step: int) -> float:
        """Of the step of this number, from 0."""
        rise = min(1.0, (step + 1) / max(1.0, _WARM_UP_SHARE * self.steps))
        fall = 0.5 * (1 + math.cos(math.pi * step / self.steps))
        return self.peak * rise * (0.01 + 0.99 * fall)

    def after_epoch(self, loss: float) -> CosineSchedule:
        """The loss does not matter."""
        return self


@dataclass(frozen=True)
class PlateauSchedule:
    """A constant rate, divided by 10 whenever the loss of an epoch stops falling."""

    current: float
    best: float = math.inf
    waited: int = 0

    def rate(self, step: int) -> float:
        """The same for every step of an epoch."""
        return self.current

    def after_epoch(self, loss: float) -> PlateauSchedule:
        """The schedule for the next epoch."""
        if loss < self.best - _TOLERANCE:
            return PlateauSchedule(self.current, loss, 0)
        if self.waited + 1 >= _PATIENCE_EPOCHS:
            return PlateauSchedule(self.current * _FACTOR, self.best, 0)
        return PlateauSchedule(self.current, self.best, self.waited + 1)


LearningRateSchedule = CosineSchedule | PlateauSchedule
