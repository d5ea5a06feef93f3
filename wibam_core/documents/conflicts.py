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
    """That the two really were in conflict, by either measure."""
    ttc_probability: float | None = None
    """That the time to collision was below its threshold; null in documents of earlier versions."""
    pet_probability: float | None = None
    """That the post-encroachment time was below its threshold; null in documents of earlier versions."""
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


class Exposure(Document):
    """Where statements about conflicts are made, and how much was seen there: what their count is to be divided by."""

    outlines_m: list[list[tuple[float, float]]]
    """Rings of x, y around the analysable area and around its holes."""
    area_m2: float
    hours: float
    """That were recorded."""
    road_user_hours: float
    """Spent there by all road users."""
    road_user_km: float
    """Gone there by all road users."""
    conflicts_elsewhere: int
    """Pairs that looked like conflicts outside, where too little is known to say so."""


class Conflicts(Document):
    """All conflicts of a job, and the thresholds that make one."""

    thresholds: dict[str, float]
    """Options of the safety stage, by name."""
    conflicts: list[ConflictRow]
    exposure: Exposure | None = None
    """Null in documents of earlier versions."""
    track_errors: dict[str, float] | None = None
    """By how much tracks err, as factors of their standard deviations, and for how long, in s, by name; null in
    documents of earlier versions."""
