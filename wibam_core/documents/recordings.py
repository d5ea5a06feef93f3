"""What the preflight finds out about the recordings."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from wibam_core.documents.base import Document


class Segment(Document):
    """A stretch of a recording on one clock: a file of several, or what follows a jump of the clock.

    All times are on the recording's one timeline, in which segments follow one another.
    """

    first_ns: int
    """Time of its first frame."""
    last_ns: int
    """Time of its last frame."""
    frames: int
    file: str
    """Name of the file that it comes from."""
    placed_by: Literal["stamps", "timecode", "creation_time", "name", "assumed"]
    """What says where it lies against the segment before. ``assumed``: nothing does, and it was put right behind, so
    that how long the camera was off is unknown until the cameras are synchronised. ``creation_time`` and ``name`` are
    exact to a second or so, the others to a frame or better."""


class VideoInfo(Document):
    """A recording, measured from its packets rather than believed from its header."""

    codec: str
    """Short name, e.g. "h264"."""
    container: str
    """Short name, e.g. "mov" (which MP4 files are, too)."""
    width_px: int
    """As shown, so after rotation."""
    height_px: int
    """As shown, so after rotation."""
    rotation_deg: int
    """How far frames are turned counter-clockwise when shown: 0, 90, 180 or 270."""
    fps: float
    """Usual frame rate: the inverse of the mean interval, gaps aside."""
    frames: int
    """Number of frames in the file."""
    missing_frames: int
    """Frames that the file's own index names beyond these: more than 0 where it was cut off."""
    first_ns: int
    """Presentation time of the first frame on the recording's own clock."""
    last_ns: int
    """Presentation time of the last frame on the recording's own clock."""
    duration_s: float
    """From the first frame to the end of the last."""
    largest_gap_s: float
    """Longest interval between two frames."""
    variable_rate: bool
    """Some intervals differ from the usual one by more than a tenth."""
    segments: list[Segment] = Field(default_factory=list)
    """In order, the first included; empty where the recording is of one piece."""


class Probe(Document):
    """All recordings of a site."""

    cameras: dict[str, VideoInfo]
    """By camera id."""


class Limits(Document):
    """What can only be checked once the clocks are known."""

    min_overlap_s: float
    """Shortest time that each recording must share with another."""
