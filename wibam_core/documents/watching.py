"""What a run of a network over new footage noticed, beside the tracks."""

from __future__ import annotations

from pydantic import Field

from wibam_core.documents.base import Document


class Stretch(Document):
    """From one time to another, reference clock."""

    from_ns: int
    to_ns: int


class CameraWatched(Document):
    """One camera's footage."""

    footage: list[Stretch]
    """When it recorded."""
    gaps: list[Stretch] = Field(default_factory=list)
    """Between the footage."""
    images: int
    """Pictures that were searched."""
    boxes: int
    """Road users that were found in them, one in each picture."""
    score: float | None = None
    """Mean of their scores."""
    usual_score: float | None = None
    """The same where the network was made."""
    usual_boxes_an_image: float | None = None


class CameraTurned(Document):
    """A look at where a camera points, against where it pointed when the network was made."""

    camera: str
    time_ns: int
    """The end of the footage that was looked at."""
    angle_deg: float
    rotation_rad: tuple[float, float, float]
    """Rotation vector in the camera's frame (x right, y down, z forward), from its old to its new directions."""
    patches: int
    """Parts of the picture that could be compared."""
    agree: float
    """Share of them that this turn explains."""
    corrected: bool
    """From then on the calibration was turned along."""


class Watched(Document):
    """What a run noticed."""

    start_ns: int
    end_ns: int
    dated: bool
    """Times are Unix time; else the reference camera's own clock."""
    instants: int
    cameras: dict[str, CameraWatched]
    turns: list[CameraTurned]
    """One a camera and look, where anything could be compared."""
    tracks: int
    by_class: dict[str, int]
    continued: bool
    """Road users that were in view at the end of the run before kept their ids."""
    missed_before: Stretch | None = None
    """What nobody recorded between that run's last picture and this one's first, if it is 2 s or more."""
