"""What the traffic says of the calibration."""

from __future__ import annotations

from pydantic import Field

from wibam_core.documents.base import Document


class RefinedCamera(Document):
    """One camera. Where the refined calibration was not taken, by how much it would have changed."""

    turned_deg: float
    """Angle between how it was held before and after."""
    moved_m: float
    focal_change: float | None = None
    """Share by which the focal length grew, where it was refined."""
    k1_change: float | None = None
    """Change of the first distortion coefficient, where it was refined."""
    late_ms: float
    """By how much its clock seems to run behind what synchronisation says, with the mean of all cameras as 0; vehicles'
    ways say so. It is not corrected."""
    rotation_sd_deg: list[float]
    """Standard deviations about the camera's x, y and z axes once the traffic was seen."""
    position_sd_m: list[float]
    """Those of the position along the world's x, y and z."""


class RefinedGround(Document):
    """Where the road's plane was found, in the world as calibrated. The refined cameras have it at Z = 0 again."""

    height_m: float
    """Where the cameras have their middle."""
    slope_x: float
    """How much it rises along the world's X, m per m."""
    slope_y: float


class HeldOut(Document):
    """Vehicles that several cameras see, each of them judged by cameras that it was left out of refining: how well they
    fit all their views."""

    vehicles: int
    before_px: float
    """Median distance of the edges of their 2D boxes, with the cameras as calibrated."""
    after_px: float
    """The same with the refined cameras."""
    gain: float
    """Mean share by which a vehicle's error falls; below 0 where it grows."""
    gain_sd: float
    """Standard deviation of that mean."""


class Refinement(Document):
    """The refinement of a site's calibration."""

    method: str
    """"traffic" or "none"."""
    taken: bool
    """Whether the cameras were changed."""
    reason: str
    """Why, in a sentence."""
    vehicles: int = 0
    """By which the cameras were refined."""
    sightings: int = 0
    """Of these."""
    held_out: HeldOut | None = None
    ground: RefinedGround | None = None
    """Null where nothing was refined."""
    cameras: dict[str, RefinedCamera] = Field(default_factory=dict)
    """By camera id; none where nothing was refined."""
    covariances: dict[str, list[list[float]]] = Field(default_factory=dict)
    """By camera id, or that of a view of a wide lens, the covariance of the camera as it is used, where anything is
    known of it: of the rotation about its axes (rad) and of the position in the world (m), in this order."""
