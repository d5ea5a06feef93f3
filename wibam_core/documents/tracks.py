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
