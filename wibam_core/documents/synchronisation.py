"""Everything that the synchronisation rests on: light changes, which of them were matched, and what remains."""

from __future__ import annotations

from typing import Literal

from wibam_core.documents.base import Document


class SeenChange(Document):
    """A traffic light seen to change in one camera."""

    signal: str
    before: str
    after: str
    time_s: float
    """On the camera's own clock."""
    half_interval_s: float
    """The change happened within ``time_s`` ± this."""
    confidence: float
    matched: bool | None = None
    """Whether other cameras were found to see the same change; null where nobody has looked."""


class Observation(Document):
    """One camera's view of a matched light change."""

    camera: str
    time_s: float
    """On the reference clock, once synchronised."""
    delay_before_s: float | None
    """Against the reference camera before synchronisation; null where that did not see the change."""
    delay_after_s: float | None
    """The same, after synchronisation."""
    residual_s: float
    """Against the mean of all cameras that saw the change, after synchronisation."""


class ChangeGroup(Document):
    """One light change seen by several cameras."""

    signal: str
    before: str
    after: str
    time_s: float
    """On the reference clock."""
    observations: list[Observation]


class Alternative(Document):
    """Another clock under which a good share of the changes meets."""

    offset_s: float
    matched: int
    could: float = 0.0
    """How many changes could meet under it, mean of both sides: both recordings cover their time."""
    score: float = 0.0
    """The share of those that could meet and do."""
    drift_ppm: float = 0.0
    excluded: bool = False
    """It explains the changes far worse than the one that was taken."""


class CameraClock(Document):
    """One camera's clock against the reference."""

    offset_s: float
    offset_sd_s: float
    drift_ppm: float
    drift_sd_ppm: float
    changes: int
    """How many changes the camera saw."""
    matched: int
    """How many of them other cameras saw, too."""
    could: float | None = None
    """How many could have met another camera's, mean of both sides; null for the reference."""
    score: float | None = None
    """The share of those that could meet and do."""
    rms_before_s: float | None
    rms_after_s: float | None
    ambiguous: bool
    """Another offset explains what is seen as well."""
    alternatives: list[Alternative]
    """Other offsets that were considered, the likeliest first."""


class Synchronisation(Document):
    """The light changes of all cameras and what was made of them; without any where the recordings share a clock."""

    method: Literal["signals", "none"]
    reference: str
    """Id of the camera whose clock is the result's clock."""
    changes: dict[str, list[SeenChange]]
    """By camera id."""
    groups: list[ChangeGroup]
    cameras: dict[str, CameraClock]
    """By camera id."""
