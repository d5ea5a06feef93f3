"""The JSON files of other stages, typed. A file that does not fit fails loudly: it is our own."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class _File(BaseModel):
    """Takes what the report shows and passes over what it does not."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class MeanSd(_File):
    """Mean and standard deviation; None where there was nothing, or one thing, to average."""

    mean: float | None = None
    sd: float | None = None


class DetectorFigures(_File):
    """How one detector did against labels. What `paper_compat` does not count is None."""

    bev_iou: MeanSd
    iou_3d: MeanSd
    ate_m: MeanSd
    ase: MeanSd
    aoe_deg: MeanSd
    matched: int
    frames: int
    alias_share: float | None = None
    missed: int | None = None
    false_positives: int | None = None
    recall: MeanSd = MeanSd()
    precision: float | None = None
    bev_iou_misses_zero: MeanSd = MeanSd()
    iou_3d_misses_zero: MeanSd = MeanSd()


class Significance(_File):
    """Fine-tuned against baseline in one metric: Z-test over boxes, bootstrap over vehicles."""

    z: float | None
    p_z: float | None
    difference: float | None
    low: float | None
    high: float | None
    p_bootstrap: float | None


class Part(_File):
    """Figures of a part of the labelled vehicles."""

    matched: int
    missed: int
    recall: float | None
    bev_iou: MeanSd
    ate_m: MeanSd
    aoe_deg: MeanSd


class Bin(Part):
    """Figures of the vehicles between ``low`` and ``high`` (None: without end)."""

    low: float | None
    high: float | None


class OfClass(Part):
    """Figures of the vehicles of a class."""

    vehicle_class: str = Field(alias="class")


class Coverage(_File):
    """Shares of errors in the intervals that should hold the shares ``level``, for Laplace and normal distributions."""

    level: list[float]
    laplace: list[float]
    normal: list[float]


class CalibrationError(_File):
    """Mean difference between the shares that intervals hold and should hold, by either distribution."""

    laplace: float
    normal: float


class SdBin(_File):
    """Errors of the boxes that state about the same standard deviation ``sd``."""

    sd: float
    rms: float
    median: float
    count: int


class Reliability(_File):
    """Stated standard deviations of one kind of number against the errors made; nothing where none is stated."""

    count: int
    scale_factor: float | None = None
    coverage: Coverage | None = None
    calibration_error: CalibrationError | None = None
    bins: list[SdBin] = []


class Consistency(_File):
    """Agreement of one detector's boxes with the 2D boxes of the views that they were not made in."""

    other_views: MeanSd
    own_view: MeanSd
    pairs: int
    found: float | None
    roughness_m: MeanSd = MeanSd()


class LabelledInstants(_File):
    """How many instants were labelled by hand, how many of them lie in the test part, and when that is."""

    given: int
    in_test_part: int
    test_from_s: float
    test_to_s: float


class Metrics(_File):
    """``metrics.json``. Without labels there is self-consistency alone."""

    options: dict[str, float]
    labels: str
    labelled_instants: LabelledInstants
    instants: int
    frames: int
    baseline: DetectorFigures | None = None
    baseline_plane: DetectorFigures | None = None
    baseline_depth: DetectorFigures | None = None
    finetuned: DetectorFigures | None = None
    paper_compat: dict[str, DetectorFigures] | None = None
    significance: dict[str, Significance] | None = None
    by_visibility: dict[str, list[Bin]] | None = None
    by_distance: dict[str, list[Bin]] | None = None
    by_elevation: dict[str, list[Bin]] | None = None
    by_class: dict[str, list[OfClass]] | None = None
    reliability: dict[str, dict[str, Reliability]] | None = None
    sd_factors: dict[str, float] | None = None
    self_consistency: dict[str, Consistency]


class Recording(_File):
    """One camera's entry of ``probe.json``."""

    codec: str
    width_px: int
    height_px: int
    fps: float
    first_ns: int
    duration_s: float


class Observation(_File):
    """A camera's view of a light change; delays are against the reference, None where that did not see it."""

    camera: str
    delay_before_s: float | None
    delay_after_s: float | None


class ChangeGroup(_File):
    """One light change seen by several cameras; ``time_s`` is on the reference clock."""

    time_s: float
    observations: list[Observation]


class Alternative(_File):
    """Another clock offset under which nearly as many changes meet."""

    offset_s: float
    matched: int


class CameraClock(_File):
    """One camera's clock against the reference."""

    offset_s: float
    offset_sd_s: float
    drift_ppm: float
    drift_sd_ppm: float
    matched: int
    rms_before_s: float | None
    rms_after_s: float | None
    ambiguous: bool
    alternatives: list[Alternative]


class Changes(_File):
    """``changes.json``; without groups and cameras where the recordings share a clock."""

    method: str
    reference: str
    groups: list[ChangeGroup]
    cameras: dict[str, CameraClock]


class Zone(_File):
    """A band of distance from a camera."""

    from_m: float
    to_m: float
    m_per_px: float | None


class CameraResiduals(_File):
    """One camera's entry of ``residuals.json``."""

    kind: str
    points: int
    rejected: int
    median_px: float | None
    max_px: float | None
    median_m: float | None
    zones: list[Zone]


class HistogramCounts(_File):
    """Counts between edges (one more than counts)."""

    edges: list[float]
    counts: list[int]


class Subset(_File):
    """One part of the annotation set."""

    instants: int
    seconds: float
    vehicles: int
    boxes: int
    tracks: int
    left_out_tracks: int


class DatasetStatistics(_File):
    """``statistics.json`` of the dataset stage."""

    subsets: dict[str, Subset]
    by_views: dict[str, int]
    by_class: dict[str, int]
    boxes_by_camera: dict[str, int]
    depth_m: HistogramCounts
    elevation_deg: HistogramCounts
    vehicles_per_instant: HistogramCounts


class AssociationStatistics(_File):
    """``statistics.json`` of the associate stage."""

    instants: int
    boxes: int
    vehicles: int
    single_view: int
    unassociated_share: float
    tracks: int


class Residual(_File):
    """Percentiles of the fits' mean 1 − GIoU over views."""

    p50: float


class LiftStatistics(_File):
    """``statistics.json`` of the lift stage; without fits there are counts alone."""

    fits: int
    kept: int
    tracks: int
    residual: Residual | None = None


class Epoch(_File):
    """Mean losses of one epoch by part, with their "total"; ``validation`` may be empty."""

    step: int
    train: dict[str, float]
    validation: dict[str, float]


class Curves(_File):
    """``curves.json``."""

    method: str
    decode: str
    input_width_px: int | None = None
    kept: str
    kept_step: int
    epochs: list[Epoch]
    warnings: list[str] = []


class Manifest(_File):
    """``manifest.json`` of a published stage."""

    digest: str
    seconds: float


class ConflictRow(_File):
    """One conflict of ``conflicts.json``; None stands for "there was none"."""

    conflict_id: int
    track_ids: tuple[int, int]
    classes: tuple[str, str]
    type: str
    time_ns: int
    x_m: float
    y_m: float
    speeds_mps: tuple[float, float]
    ttc_s: float | None
    ttc_interval_s: tuple[float | None, float | None]
    probability: float | None
    pet_s: float | None
    pet_interval_s: tuple[float | None, float | None]
    deceleration_mps2: float
    duration_s: float


class Conflicts(_File):
    """``conflicts.json``."""

    thresholds: dict[str, float]
    conflicts: list[ConflictRow]
