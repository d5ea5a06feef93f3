"""Tracks as the API says them: one state of one road user at one time."""

from __future__ import annotations

from pydantic import Field

from wibam_core.documents.base import Document


class TrackState(Document):
    """A road user at one time: place, size, yaw, motion, and the standard deviation of each of the box's numbers.

    The fields are the columns of `wibam_core.formats.tracks.SCHEMA`; an unknown standard deviation is null.
    """

    time_ns: int
    """Reference clock."""
    track_id: int
    road_user_class: str = Field(alias="class")
    x_m: float
    """The box's centre in the world."""
    y_m: float
    z_m: float
    length_m: float
    width_m: float
    height_m: float
    yaw_rad: float
    """About world Z, counter-clockwise from X, in (−π, π]."""
    vx_mps: float
    vy_mps: float
    speed_mps: float
    yaw_rate_radps: float
    sd_x_m: float | None
    sd_y_m: float | None
    sd_z_m: float | None
    sd_length_m: float | None
    sd_width_m: float | None
    sd_height_m: float | None
    sd_yaw_rad: float | None


class TrackPage(Document):
    """States of tracked road users, sorted by time, then track."""

    states: list[TrackState]
    next: str | None
    """Cursor of the next page."""


class ClassTracks(Document):
    """How many road users of one class there are, and how many states of them."""

    road_user_class: str = Field(alias="class")
    tracks: int
    states: int


class TracksSummary(Document):
    """What can be said of states without listing them; null where there are none."""

    states: int
    tracks: int
    first_ns: int | None
    """Reference clock, as all times."""
    last_ns: int | None
    period_ns: int | None
    """Between two instants with states, as a rule: the median. Null of a single instant."""
    fastest_mps: float | None
    bounds_m: tuple[float, float, float, float] | None
    """Least x and y, greatest x and y of the boxes' centres."""
    classes: list[ClassTracks]
    """The most frequent first."""


class CompactTrack(Document):
    """States of one road user, a list for each number, rounded to what a picture shows.

    All lists are as long as `at`, but a number that is the same in all states stands there once.
    """

    track_id: int
    road_user_class: str = Field(alias="class")
    at: list[int]
    """Of each state the place of its time in `times_ns`."""
    x_m: list[float]
    """The box's centre in the world, to 1 cm, as all lengths."""
    y_m: list[float]
    z_m: list[float]
    length_m: list[float]
    width_m: list[float]
    height_m: list[float]
    yaw_rad: list[float]
    """To 1 mrad."""
    speed_mps: list[float]
    """Rounded down, to 1 cm/s: as many reach a limit of whole cm/s as of the states in full."""


class CompactTracks(Document):
    """States of tracked road users by track, for drawing: a tenth of a `TrackPage`, without motion and errors."""

    times_ns: list[int]
    """Reference clock, ascending."""
    tracks: list[CompactTrack]
    next: str | None
    """Cursor of the next page."""


class TrackPath(Document):
    """Where one road user went: corners of a line.

    Where it was at the instants that were looked at is nowhere farther from the line than the tolerance; one corner
    says that it stood.
    """

    track_id: int
    road_user_class: str = Field(alias="class")
    x_m: list[float]
    """Of the corners, in their order in time, to 1 cm."""
    y_m: list[float]


class TrackPaths(Document):
    """Where road users went, thinned to be drawn together."""

    tracks: int
    """How many match; where these are too many to be drawn, `paths` has every second, third, ... of them. It lacks who
    was there only between the instants that were looked at, too."""
    tolerance_m: float
    """Of states at the instants that were looked at; those in between may lie farther off."""
    period_ns: int | None
    """Between the instants that were looked at: of very many states not all are; null of a single instant."""
    paths: list[TrackPath]
