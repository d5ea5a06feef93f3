"""How good the networks are: against hand labels, where there are any, and against the other views always."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from wibam_core.documents.base import Document, MeanSd


class DetectorFigures(Document):
    """How one network did against labels. What `paper_compat` does not count is null."""

    bev_iou: MeanSd
    """IoU of the ground rectangles, over matches."""
    iou_3d: MeanSd
    ate_m: MeanSd
    """Translation error: distance of the centres on the ground."""
    ase: MeanSd
    """Scale error: 1 − IoU of the ground rectangles once place and yaw are aligned."""
    aoe_deg: MeanSd
    """Orientation error: smallest difference of yaw."""
    matched: int
    frames: int
    alias_share: float | None = None
    """Share of the matches whose yaw is off by 150° and more."""
    missed: int | None = None
    false_positives: int | None = None
    recall: MeanSd = MeanSd()
    """Its standard deviation is over vehicles."""
    precision: float | None = None
    bev_iou_misses_zero: MeanSd = MeanSd()
    """BEV IoU with every missed vehicle counted as 0."""
    iou_3d_misses_zero: MeanSd = MeanSd()


class Significance(Document):
    """Fine-tuned against baseline in one metric: Z-test over boxes, bootstrap over vehicles."""

    z: float | None
    p_z: float | None
    difference: float | None
    low: float | None
    """Lower end of the 95 % interval of the difference, by bootstrap; null of too few vehicles, as `p_bootstrap` is."""
    high: float | None
    p_bootstrap: float | None
    vehicles: int | None = None
    """How many different vehicles the figure is of, of that network that found fewer; fewer than six tell nothing."""

    @property
    def is_of_too_few(self) -> bool:
        """Whether there is a difference, and too few vehicles to say how sure it is."""
        return self.difference is not None and self.p_bootstrap is None


class Part(Document):
    """Figures of a part of the labelled vehicles."""

    matched: int
    missed: int
    recall: float | None
    bev_iou: MeanSd
    iou_3d: MeanSd
    ate_m: MeanSd
    ase: MeanSd
    aoe_deg: MeanSd


class Bin(Part):
    """Figures of the vehicles between ``low`` and ``high`` (null: without end)."""

    low: float | None
    high: float | None


class OfClass(Part):
    """Figures of the road users of a class."""

    road_user_class: str = Field(alias="class")


class Coverage(Document):
    """Shares of errors in the intervals that should hold the shares ``level``, for Laplace and normal distributions."""

    level: list[float]
    laplace: list[float]
    normal: list[float]


class CalibrationError(Document):
    """Mean difference between the shares that intervals hold and should hold, by either distribution."""

    laplace: float
    normal: float


class SdBin(Document):
    """Errors of the boxes that state about the same standard deviation ``sd``."""

    sd: float
    rms: float
    median: float
    count: int


class Reliability(Document):
    """Stated standard deviations of one kind of number against the errors made; nothing where none is stated."""

    count: int
    scale_factor: float | None = None
    """What the stated standard deviations would have to be multiplied with."""
    coverage: Coverage | None = None
    calibration_error: CalibrationError | None = None
    bins: tuple[SdBin, ...] = ()


class Consistency(Document):
    """Agreement of one network's boxes with the 2D boxes of the views that they were not made in."""

    other_views: MeanSd
    """IoU of the reprojected boxes in the other views."""
    own_view: MeanSd
    roughness_m: MeanSd = MeanSd()
    """Distance of each box from the straight line between the same vehicle's boxes before and after it."""
    pairs: int
    """Boxes times views that were compared."""
    found: float | None
    """Share of the sightings of multi-view vehicles that the network found."""


class LabelledInstants(Document):
    """How many instants were labelled by hand, how many of them lie in the test part, and when that is."""

    given: int
    in_test_part: int
    test_from_s: float
    test_to_s: float


class Metrics(Document):
    """The evaluation of a job. Without labels there is self-consistency alone, and the rest is null."""

    options: dict[str, float]
    """Options of the evaluate stage, by name."""
    labels: Literal["hand", "none"]
    labelled_instants: LabelledInstants
    not_asked_for: list[str]
    """Road users that the networks do not know: where they are labelled or seen, they count nowhere."""
    instants: int
    frames: int
    baseline: DetectorFigures | None = None
    """The network before fine-tuning, its boxes placed as the fine-tuned network's are."""
    baseline_plane: DetectorFigures | None = None
    """The same, placed on the ground plane, unless that is how the fine-tuned network's are."""
    baseline_depth: DetectorFigures | None = None
    """The same, placed at the regressed depth, unless that is how the fine-tuned network's are."""
    finetuned: DetectorFigures | None = None
    paper_compat: dict[str, DetectorFigures] | None = None
    """All networks as the published evaluation would count."""
    significance: dict[str, Significance] | None = None
    """By metric."""
    by_visibility: dict[str, list[Bin]] | None = None
    """By network, in bins of the share of a vehicle that the camera sees."""
    by_distance: dict[str, list[Bin]] | None = None
    """By network, in bins of the distance from the camera in m."""
    by_elevation: dict[str, list[Bin]] | None = None
    """By network, in bins of the elevation angle in degrees."""
    by_class: dict[str, list[OfClass]] | None = None
    """By network."""
    reliability: dict[str, dict[str, Reliability]] | None = None
    """By network and kind of number."""
    sd_factors: dict[str, float] | None = None
    """Kind of number -> what the fine-tuned network's standard deviations were multiplied with."""
    self_consistency: dict[str, Consistency]
    """By network."""
