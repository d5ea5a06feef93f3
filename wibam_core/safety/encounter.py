"""Two road users at the moment of their conflict, and what can be measured of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Encounter:
    """Two road users at one moment; where they only shared a place, each when it left or reached that.

    Attributes:
        boxes: (2, 7) in the world, m and rad.
        velocities_mps: (2, 2) in the world.
        ttc_s: time to collision; inf where none was foreseen.
    """

    boxes: Array
    velocities_mps: Array
    ttc_s: float


@dataclass(frozen=True)
class Measure:
    """One further figure of how severe a conflict is. It decides nothing: `wibam_core.safety.conflicts` does.

    Attributes:
        name: of the figure in documents; it ends in the unit.
        title: of its column, with the unit.
        meaning: what follows the title in an explanation.
        digits: decimals for a person.
        of: its value; NaN or infinite where there is none.
    """

    name: str
    title: str
    meaning: str
    digits: int
    of: Callable[[Encounter], float]
