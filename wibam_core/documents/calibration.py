"""How well the calibrated cameras fit what the user said."""

from __future__ import annotations

from wibam_core.documents.base import Document


class Zone(Document):
    """A band of distance from a camera, on the ground."""

    from_m: float
    to_m: float
    points: int
    """How many of the user's points lie in it."""
    median_px: float | None
    """Reprojection error of these points."""
    median_m: float | None
    """Their error on the ground."""
    m_per_px: float | None
    """How far a ground point there moves when its pixel is one off: at worst over directions in the image, at the
    median over the zone; null where the camera sees no ground in it."""


class PointResidual(Document):
    """One of the user's points."""

    world: list[float]
    """x, y, z in m."""
    pixel: list[float]
    """u, v in px of the recording."""
    used: bool
    """False where the point was taken for an outlier."""
    error_px: float | None
    error_m: float | None


class CameraResiduals(Document):
    """One camera's calibration."""

    kind: str
    """"matrices", "pnp", "homography" or "points"."""
    lens: str = "pinhole"
    """"pinhole", "fisheye" or "omnidirectional"."""
    position_m: list[float]
    """x, y, z of the camera in the world."""
    focal_px: list[float]
    """Focal length in x and y."""
    position_sd_m: list[float] | None = None
    """Standard deviations of the position along the world's x, y and z, from the residuals; null for ready matrices,
    and where there are fewer than five points to tell by."""
    rotation_sd_deg: list[float] | None = None
    """Those of the rotation about the camera's x, y and z axes (x right, y down, z forward)."""
    focal_sd_px: float | None = None
    """That of the focal length, where it was solved from the points."""
    k1: float | None = None
    """The first coefficient of the distortion, where it was solved from the points."""
    k1_sd: float | None = None
    """Its standard deviation."""
    ground_sd_m: float | None = None
    """That of places on the ground within 50 m, at the median over what the camera sees."""
    covariance: list[list[float]] | None = None
    """All of these together: of the rotation (rad), the position (m) and, where they were solved, the logarithm of the
    focal length, the principal point (px) and k1, in this order. What was given is taken to be exact."""
    points: int
    rejected: int
    median_px: float | None
    rms_px: float | None
    max_px: float | None
    median_m: float | None
    zones: list[Zone]
    residuals: list[PointResidual]


class PairOverlap(Document):
    """The road that two cameras see."""

    cameras: list[str]
    """Ids of the two."""
    area_m2: float
    share: float
    """Of what the camera sees that sees less."""


class Overlap(Document):
    """What cameras see of the road near the middle of all of them, were nothing in the way."""

    within_m: float
    """So far from the middle is looked at."""
    area_m2: dict[str, float]
    """By camera id."""
    pairs: list[PairOverlap]
    seen_by_m2: dict[str, float]
    """Number of cameras -> area that so many see at least."""


class CalibrationResiduals(Document):
    """The calibration of all cameras."""

    overlap: Overlap | None = None
    """Null for calibrations of versions that did not look."""
    cameras: dict[str, CameraResiduals]
    """By camera id."""
