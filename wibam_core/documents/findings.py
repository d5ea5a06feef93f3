"""What a job's stages say of one instant, for drawing it."""

from __future__ import annotations

from pydantic import Field

from wibam_core.documents.base import Document


class SeenBox(Document):
    """A 2D box in one camera's frame."""

    box_px: tuple[float, float, float, float]
    """x0, y0, x1, y1 in px of the recording, around what is seen."""
    whole_px: tuple[float, float, float, float] | None
    """Around the whole road user, hidden parts included, where that is known."""
    road_user_class: str = Field(alias="class")
    score: float
    vehicle: int | None
    """`id` of the vehicle that it was associated with; null where it was with none."""
    ground_m: tuple[float, float] | None
    """Where the ray through its middle meets the ground; null where it never does."""


class FoundVehicle(Document):
    """A road user that association found in one or more cameras."""

    id: int
    """Unique within the instant."""
    track: int
    """The same over time; −1 where it could not be linked."""
    road_user_class: str = Field(alias="class")
    x_m: float
    """Where its rays meet."""
    y_m: float
    cameras: tuple[str, ...]


class FoundBox(Document):
    """A 3D box."""

    box: tuple[float, float, float, float, float, float, float]
    """Centre x, y, z (m), length, width, height (m), yaw (rad)."""
    road_user_class: str = Field(alias="class")
    score: float
    id: int
    """Of the vehicle over time; −1 where that is not known."""


class InstantFindings(Document):
    """What is known of an instant; what a stage has not made yet is empty."""

    time_ns: int
    detections: dict[str, tuple[SeenBox, ...]]
    """By camera id."""
    vehicles: tuple[FoundVehicle, ...]
    fits: tuple[FoundBox, ...]
    """7DoF boxes fitted to all views."""
    baseline: dict[str, tuple[FoundBox, ...]]
    """Camera id -> what the network says of that camera's frame alone, before fine-tuning; in the test part."""
    finetuned: dict[str, tuple[FoundBox, ...]]
    """The same after fine-tuning."""
