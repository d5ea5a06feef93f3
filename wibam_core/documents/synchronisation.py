"""Everything that the synchronisation rests on: light changes, which of them were matched, and what remains."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

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


class PlacedSegment(Document):
    """A segment of a recording that lies elsewhere than assumed: the camera was off for an unknown time before it."""

    from_s: float
    """Its beginning, on the camera's own clock."""
    shift_s: float
    """By how much later it lies than where it was put."""
    sd_s: float
    """Standard deviation of its place on the reference clock, in the middle of what tells it."""
    matched: int
    """How many of its light changes other cameras saw, too."""


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
    road_users: int = 0
    """Road users that it was found to share with another camera: the most with any one."""
    decided_by_traffic: bool = False
    """The traffic has chosen among offsets that the lights leave open, or the camera shares no light change."""
    decided_by_sound: bool = False
    """The sound has chosen among offsets that the lights leave open, and that the traffic says nothing of."""
    segments: list[PlacedSegment] = Field(default_factory=list)
    """Segments of the recording that were placed by themselves; offset and drift are those of its beginning."""
    assumed_from_s: list[float] = Field(default_factory=list)
    """Beginnings, on the camera's own clock, of segments that nothing places: they lie where they were put."""


class TrafficPair(Document):
    """What the road users say of two cameras' clocks: ``first = second + offset_s + drift * second``."""

    first: str
    second: str
    offset_s: float
    drift_ppm: float
    matched: int
    """Road users that both see under this offset."""
    could: float
    """Road users that both could see, mean of both sides."""
    score: float
    """The share of these that both see."""
    clear: bool
    """No other offset explains as much, and enough road users meet; only then is it used."""
    sd_s: float | None
    drift_sd_ppm: float | None
    residual_s: float | None
    """The pair's own answer minus that of all witnesses together, where its own is most exact."""
    alternatives: list[Alternative]


class SoundPair(Document):
    """What the sound of two recordings says of their clocks: ``first = second + offset_s``. It moves no clock."""

    first: str
    second: str
    offset_s: float
    """In the middle of the second recording."""
    sd_s: float
    strength: float
    """By how many standard deviations more meets under this offset than by chance."""
    contrast: float
    """By how many times more meets than under the best other offset."""
    clear: bool
    """It is believed: strong, far beyond any other offset, and not by a few loud sounds alone."""
    residual_s: float
    """The sound's answer minus that of all witnesses together."""
    agrees: bool | None
    """Whether both mean the same, as far as the way of sound between the cameras tells; null where it is not clear."""


class Synchronisation(Document):
    """What witnesses say and what was made of it; nothing where the recordings share a clock.

    Of the published scheme's two signals, green to amber measures and amber to red synchronises; here all changes do
    both, each group says which it is, and so does ``rms_after_by_change_s``.
    """

    method: Literal["signals", "traffic", "both", "none"]
    reference: str
    """Id of the camera whose clock is the result's clock."""
    changes: dict[str, list[SeenChange]]
    """By camera id."""
    groups: list[ChangeGroup]
    cameras: dict[str, CameraClock]
    """By camera id."""
    traffic: list[TrafficPair] = Field(default_factory=list)
    """Every two cameras that road users may connect; empty where the traffic was not asked."""
    sound: list[SoundPair] = Field(default_factory=list)
    """Every two cameras whose recordings have sound that could be compared."""
    disagreeing: list[str] = Field(default_factory=list)
    """Cameras whose light changes say otherwise than the traffic, and were left out."""
    rms_after_by_change_s: dict[str, float] = Field(default_factory=dict)
    """Kind of change, "green to amber" the published measurement and "amber to red" the published synchronisation
    signal -> root mean square of the residuals of its observations."""
