"""Everything that a report shows, read and typed, before anything is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.calibration import Overlap
from wibam_core.documents.conflicts import ConflictRow, Exposure
from wibam_core.documents.metrics import Metrics
from wibam_core.documents.refinement import Refinement
from wibam_core.documents.rounds import Rounds
from wibam_core.documents.statistics import SubsetStatistics
from wibam_core.documents.synchronisation import Alternative, PlacedSegment, SoundPair, TrafficPair
from wibam_core.documents.warnings import StageWarning
from wibam_core.geometry.camera import Camera
from wibam_core.report.bev import BoxesInstant, ClusteredInstant
from wibam_core.report.charts import Bars, Curve, Delay, Histogram
from wibam_core.scene import CameraRig, Track

Image = NDArray[np.uint8]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """One camera's file."""

    camera_id: str
    codec: str
    width_px: int
    height_px: int
    fps: float
    duration_s: float


@dataclass(frozen=True)
class ClockRow:
    """One camera's clock against the reference; None where it is unknown.

    Attributes:
        offset_s: at the start of the camera's own clock, with its standard deviation ``offset_sd_s``.
        drift_ppm: with its standard deviation ``drift_sd_ppm``.
        changes: light changes that it shares with another camera. score: of those that it could share, how many.
        ambiguous: another offset explains what is seen as well.
        by_traffic, by_sound: who has chosen among offsets that the lights leave open.
        rms_before_s, rms_after_s: root mean square delay to the reference.
    """

    camera_id: str
    offset_s: float
    offset_sd_s: float | None
    drift_ppm: float
    drift_sd_ppm: float | None
    changes: int
    rms_before_s: float | None
    rms_after_s: float | None
    score: float | None = None
    ambiguous: bool = False
    by_traffic: bool = False
    by_sound: bool = False


@dataclass(frozen=True)
class Synchronisation:
    """Clocks and delays of the light changes; ``measured`` is False where the cameras were taken to share a clock.

    Attributes:
        clocks: one a camera.
        delays: one a shared light change and camera.
        measured: whether anybody looked.
        candidates: by camera, other offsets that its light changes were compared under, the likeliest first.
        pairs: what the road users say of two cameras.
        segments: by camera, segments of its recording that were placed by themselves.
        sounds: what the sound of two recordings says.
    """

    clocks: tuple[ClockRow, ...]
    delays: tuple[Delay, ...]
    measured: bool = True
    candidates: tuple[tuple[str, Alternative], ...] = ()
    pairs: tuple[TrafficPair, ...] = ()
    segments: tuple[tuple[str, PlacedSegment], ...] = ()
    sounds: tuple[SoundPair, ...] = ()


@dataclass(frozen=True)
class CalibrationRow:
    """One camera's residuals; None where there is no measured point to compare with.

    Attributes:
        kind: "matrices", "pnp", "homography" or "points".
        points: measured ones. rejected: of them, those that the camera does not rest on.
        median_px, max_px: reprojection error. median_m: distance on the ground.
        position_sd_m: standard deviation of the position, all directions together.
        ground_sd_m: of places on the ground near the camera.
        pixel_m: distance (from, to) in m -> how far a ground point there moves when its pixel is one off, m.
    """

    camera_id: str
    kind: str
    points: int
    rejected: int
    median_px: float | None
    max_px: float | None
    median_m: float | None
    position_sd_m: float | None
    ground_sd_m: float | None
    pixel_m: Mapping[tuple[float, float], float]


@dataclass(frozen=True)
class Dataset:
    """The automatic annotation set.

    Attributes:
        detected_boxes: 2D boxes at all instants. unassociated_share: of them, without a match in another view.
        single_view: vehicles that one camera alone saw.
        subsets: "train", "val" and "test", in this order. plots: distributions over the instants of all subsets.
    """

    detected_boxes: int
    unassociated_share: float
    single_view: int
    subsets: Mapping[str, SubsetStatistics]
    plots: tuple[Histogram | Bars, ...]


@dataclass(frozen=True)
class Training:
    """How the network was taught: losses in all and by part, whose weights were kept, (what, value)."""

    totals: tuple[Curve, ...]
    parts: tuple[Curve, ...]
    kept_step: int
    facts: tuple[tuple[str, str], ...]


@dataclass(frozen=True, eq=False)
class Example:
    """One frame that boxes were predicted in, and another view of the same instant to reproject them into.

    Attributes:
        time_s: since the start of the recording.
        camera_id: the view that the network saw. other_id: a view that it did not see, or None.
        cameras: camera id -> camera, of those two views.
        images: camera id -> (H, W, 3), BGR, of those two views.
        baseline, finetuned: (N, 7) boxes predicted in ``camera_id``. labels: (N, 7), or None without labels.
    """

    time_s: float
    camera_id: str
    other_id: str | None
    cameras: Mapping[str, Camera]
    images: Mapping[str, Image]
    baseline: Array
    finetuned: Array
    labels: Array | None


@dataclass(frozen=True)
class StageRow:
    """One stage of the job: hash of everything its output depends on, and how long it ran, where that is known."""

    title: str
    hash: str
    seconds: float | None


@dataclass(frozen=True, eq=False)
class ReportData:
    """What the report shows.

    Attributes:
        site_name: as the user wrote it.
        version: of this software.
        warnings: of all stages, in their order.
        typical_images: camera id -> (H, W, 3), BGR, without what moves.
        examples: pictures before and after. boxes: the same seen from above. clusters: rays of single instants.
        options: (stage.option, value) as far as stages wrote them down.
    """

    site_name: str
    version: str
    warnings: tuple[StageWarning, ...]
    rig: CameraRig
    recordings: tuple[Recording, ...]
    synchronisation: Synchronisation
    calibration: tuple[CalibrationRow, ...]
    overlap: Overlap | None
    refinement: Refinement
    dataset: Dataset
    rounds: Rounds
    training: Training
    metrics: Metrics
    tracks: tuple[Track, ...]
    conflicts: tuple[ConflictRow, ...]
    conflict_thresholds: Mapping[str, float]
    exposure: Exposure | None
    typical_images: Mapping[str, Image]
    clusters: tuple[ClusteredInstant, ...]
    boxes: tuple[BoxesInstant, ...]
    examples: tuple[Example, ...]
    stages: tuple[StageRow, ...]
    options: tuple[tuple[str, str], ...]
