"""What is measured of every conflict beside what makes it one: a line each."""

from __future__ import annotations

from wibam_core.safety.delta_speed import DELTA_SPEED
from wibam_core.safety.encounter import Encounter, Measure
from wibam_core.safety.stopping import STOPPING_SHARE

MEASURES: tuple[Measure, ...] = (
    DELTA_SPEED,
    STOPPING_SHARE,
)


def measured(encounter: Encounter) -> dict[str, float]:
    """All measures by name."""
    return {measure.name: measure.of(encounter) for measure in MEASURES}
