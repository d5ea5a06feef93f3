"""Drivers who take risks: near misses that are real, for what is to find them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wibam_core.synthetic.driving import Driver

#: Who runs red goes on where the stop line is less than so many seconds away at amber.
RED_RUN_S = 4.0
#: Forcing drivers leave where ways cross up to so long before or after the other arrives there, in s.
_FORCED_S = (-1.4, -0.2)


@dataclass(frozen=True)
class Risks:
    """How many drivers take risks, as shares of all; who takes which is drawn apart, so that the rest stays as it is.

    Attributes:
        looking_away: see late that the one ahead is slower, and brake hard.
        forcing: turn or cross before others who have to brake for them, and do not wait until the middle is clear.
        running_red: pass lights that have just turned red.
    """

    looking_away: float = 0.0
    forcing: float = 0.0
    running_red: float = 0.0


class Daring:
    """Gives some drivers what makes them dangerous."""

    def __init__(self, risks: Risks, rng: np.random.Generator) -> None:
        self._risks, self._rng = risks, rng

    def touch(self, driver: Driver) -> None:
        away, forcing, red, margin = self._rng.random(4).tolist()
        driver.looks_away = away < self._risks.looking_away
        driver.runs_red = red < self._risks.running_red
        if forcing < self._risks.forcing:
            driver.margin_s = _FORCED_S[0] + margin * (_FORCED_S[1] - _FORCED_S[0])
            driver.impatient = True
