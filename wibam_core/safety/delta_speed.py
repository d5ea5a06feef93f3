"""How differently two road users move (DeltaS)."""

from __future__ import annotations

import numpy as np

from wibam_core.safety.encounter import Encounter, Measure


def delta_speed_mps(encounter: Encounter) -> float:
    """Length of the difference of the two velocities: DeltaS of the SSAM (Gettman et al. 2008, FHWA-HRT-08-051)."""
    first, second = encounter.velocities_mps
    return float(np.hypot(*(second - first)))


DELTA_SPEED = Measure(
    "delta_speed_mps",
    "ΔS (m/s)",
    "how differently the two move, speed and direction together; a crash grows worse with it",
    1,
    delta_speed_mps,
)
