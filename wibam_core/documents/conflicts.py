"""Conflicts between road users."""

from __future__ import annotations

from wibam_core.documents.base import Document


class ConflictRow(Document):
    """One conflict; null stands for "there was none"."""

    conflict_id: int
    track_ids: tuple[int, int]
    classes: tuple[str, str]
    type: str
    """"rear_end", "crossing", "merging" or "head_on"."""
    time_ns: int
    """Reference clock."""
    x_m: float
    y_m: float
    speeds_mps: tuple[float, float]
    ttc_s: float | None
    """Least time to collision."""
    ttc_interval_s: tuple[float | None, float | None]
    """Its 90 % interval."""
    probability: float | None
    """That the time to collision was below the threshold."""
    pet_s: float | None
    """Post-encroachment time."""
    pet_interval_s: tuple[float | None, float | None]
    """Its 90 % interval."""
    deceleration_mps2: float
    """Deceleration rate to avoid the crash (DRAC)."""
    duration_s: float
    """How long the time to collision stayed below the threshold."""
    heading_difference_deg: float
    measures: dict[str, float | None]
    """What else is measured of the two at that time, by name, in the unit that the name ends in, if any."""


class Conflicts(Document):
    """All conflicts of a job, and the thresholds that make one."""

    thresholds: dict[str, float]
    """Options of the safety stage, by name."""
    conflicts: list[ConflictRow]
