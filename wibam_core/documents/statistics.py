"""Counts and distributions of what was detected, associated, split and fitted."""

from __future__ import annotations

from pydantic import Field

from wibam_core.documents.base import Document, Histogram


class DetectionStatistics(Document):
    """What the 2D detector found."""

    frames: int
    """Images that were searched."""
    boxes: int
    boxes_by_camera: dict[str, int]
    boxes_by_class: dict[str, int]
    """Of the classes that the detector knows."""
    unknown_classes: list[str]
    """Road users that the detector does not know: they are not found, or taken for one of another class."""


class AssociationAgreement(Document):
    """Pairs of boxes of different cameras said to show one vehicle, by our method and by the published one."""

    tracked_pairs: int
    """By ours (`associate.method` "tracked")."""
    paper_pairs: int
    """By the published one ("paper")."""
    both: int
    """By both of them."""


class AssociationStatistics(Document):
    """What became of the 2D boxes."""

    instants: int
    boxes: int
    vehicles: int
    """Sightings by at least two cameras: one per instant."""
    by_views: dict[str, int]
    """These by number of views."""
    single_view: int
    """Sightings by one camera alone."""
    unassociated_share: float
    """Share of the boxes that share a vehicle with no other camera's box."""
    tracks: int
    """Vehicles linked over time."""
    most_vehicles_at_once: int
    method: str = "tracked"
    """`associate.method`, by which these figures are."""
    agreement: AssociationAgreement | None = None
    """With the other method; null where nobody compared them."""


class SubsetStatistics(Document):
    """One part of the annotation set."""

    instants: int
    seconds: float
    vehicles: int
    """Sightings by at least two cameras."""
    boxes: int
    tracks: int
    left_out_tracks: int


class DatasetStatistics(Document):
    """The annotation set by part, and its distributions over all parts."""

    subsets: dict[str, SubsetStatistics]
    """"train", "val" and "test"."""
    by_views: dict[str, int]
    by_class: dict[str, int]
    boxes_by_camera: dict[str, int]
    depth_m: Histogram
    """Distance along the optical axis, per view."""
    elevation_deg: Histogram
    """Angle below the horizontal, per view."""
    vehicles_per_instant: Histogram
    sightings_per_track: Histogram


class ResidualPercentiles(Document):
    """Percentiles of the fits' mean 1 − GIoU over views."""

    p10: float
    p50: float
    p90: float


class FitsByViews(Document):
    """Fits that rest on one number of views, and their median residual."""

    fits: int
    residual: float


class LearnedBody(Document):
    """How a class's body was corrected by what its tracks show."""

    tracks: int
    modes: dict[str, float]
    """Mode of shape -> by how much the body has it."""
    sd: dict[str, float]
    """Mode of shape -> standard deviation of that."""


class LiftStatistics(Document):
    """The 7DoF fits; without any there are counts alone."""

    fits: int
    kept: int
    """Fits that are good enough to train on."""
    doubled: int = 0
    """Good ones that were left out, as they stand in another vehicle's: one vehicle that was associated as two."""
    tracks: int
    kept_share: float | None = None
    residual_limit: float | None = None
    """Largest residual of those."""
    edge_noise: float | None = None
    """How much noisier edges are than stated."""
    edge_offsets_px: list[float] | None = None
    """How much farther right and down than the vehicles' all left, top, right and bottom edges lie; taken off."""
    edge_persistence: float | None = None
    """Correlation of an edge's error from one instant to the next."""
    bodies: dict[str, LearnedBody] = Field(default_factory=dict)
    """By class."""
    residual: ResidualPercentiles | None = None
    by_views: dict[str, FitsByViews] = Field(default_factory=dict)
    written: dict[str, int] = Field(default_factory=dict)
    """Part of the split -> fits that were written for it."""
