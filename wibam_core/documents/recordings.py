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
    placed_by: Literal["stamps", "timecode", "chapter", "creation_time", "name", "stated", "assumed"]
    """What says where it lies against the segment before. ``assumed``: nothing does, and it was put right behind, so
    that how long the camera was off is unknown until the cameras are synchronised. ``chapter``: cameras cut chapters
    without losing a frame. ``stated``: whoever uploaded it said when it began. ``creation_time`` and ``name`` are exact
    to a second or so, ``stated`` as the clock was that it was read from, the others to a frame."""


class SizeChange(Document):
    """From when on a recording's pictures have another size."""

    time_ns: int
    width_px: int
    height_px: int


class RateChange(Document):
    """From when on a recording has another frame rate."""

    time_ns: int
    fps: float
    """From then on."""
    before_fps: float


class VideoInfo(Document):
    """A recording, measured from its packets rather than believed from its header."""

    codec: str
    """Short name, e.g. "h264"."""
    container: str
    """Short name, e.g. "mov" (which MP4 files are, too)."""
    width_px: int
    """Of the pictures that are worked on: as shown, so after rotation."""
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
    still_ns: tuple[int, int] | None = None
    """Between these times all pictures that were looked at, some seconds apart, are one and the same; null for none."""
    variable_rate: bool
    """Some intervals differ from the usual one by more than a tenth."""
    segments: list[Segment] = Field(default_factory=list)
    """In order, the first included; empty where the recording is of one piece."""
    files: int = 1
    """How many files the recording was uploaded as."""
    missing_files: list[str] = Field(default_factory=list)
    """Names of chapters that should lie between these."""
    doubled_frames: int = 0
    """Frames that two files both held; each is used once."""
    unused_frames: int = 0
    """Frames whose stamp is stray, missing or another frame's, and which nothing can be done with."""
    stray_frames: int = 0
    """Those of them whose stamp is far from those around."""
    smeared_frames: int = 0
    """Frames after ones that were lost on the way, up to the next that is whole by itself: they show things where they
    were before. Known of H.264 and of MPEG transport streams."""
    unread_share: float = 0.0
    """Share of a file that lies in tracks or recordings of their own, before or behind the one that is read."""
    hidden_frames: int = 0
    """Frames that the file itself says are not to be shown (edit list)."""
    stretches: int = 1
    """How many stretches of a file are shown one after the other, as if no time lay between (edit list)."""
    lead_in_frames: int = 0
    """Frames before the first that decodes by itself, where the recording begins between two of these."""
    missing_s: float = 0.0
    """How much earlier the pictures end than the header says, where it gives no number of frames."""
    captured_fps: float | None = None
    """The rate at which the camera took pictures, where the file says it: of slow motion more than `fps`."""
    mirrored: bool = False
    """Left and right are exchanged when shown, before the turn."""
    stored_px: tuple[int, int] | None = None
    """Width and height as stored, turned as shown, where the pictures were brought to another size."""
    pixel_aspect: float = 1.0
    """Width of a stored pixel over its height."""
    aspect_stated: bool = True
    """Whether the file says that; else pixels were taken to be square."""
    size_changes: list[SizeChange] = Field(default_factory=list)
    """Where the size changes midway; all pictures are brought to one size."""
    rate_changes: list[RateChange] = Field(default_factory=list)
    """Segments whose frame rate is another than that of the one before, by more than a half."""
    interlaced: bool = False
    """Pictures consist of two fields, which are joined."""
    high_range: bool = False
    """Brightness is coded for high dynamic range."""
    has_clock: bool = True
    """False where the file holds no times, and its nominal rate was taken for true."""
    video_tracks: int = 1
    """Tracks of the file that could be the recording; the one that a player shows is used."""


class Probe(Document):
    """All recordings of a site."""

    cameras: dict[str, VideoInfo]
    """By camera id."""


class Limits(Document):
    """What can only be checked once the clocks are known."""

    min_overlap_s: float
    """Shortest time that each recording must share with another."""
