"""All artifacts. A new one is an entry here; the stage that makes it and those that read it name it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from wibam_core.artifacts.artifact import Artifact
from wibam_core.artifacts.codecs import BINARY, JSON, PARQUET, Codec, document, opaque, own_format, text
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.documents.conflicts import Conflicts
from wibam_core.documents.curves import Curves
from wibam_core.documents.metrics import Metrics
from wibam_core.documents.recordings import Limits, Probe
from wibam_core.documents.refinement import Refinement
from wibam_core.documents.rounds import Rounds
from wibam_core.documents.split import Split
from wibam_core.documents.statistics import (
    AssociationStatistics,
    DatasetStatistics,
    DetectionStatistics,
    LiftStatistics,
)
from wibam_core.documents.synchronisation import Synchronisation
from wibam_core.documents.watching import Watched
from wibam_core.formats.annotations import read_annotations, write_annotations
from wibam_core.formats.clocks import read_clocks, write_clocks
from wibam_core.formats.detections import read_detections, write_detections
from wibam_core.formats.framestore import FrameStore
from wibam_core.formats.instants import read_instants, write_instants
from wibam_core.formats.predictions import Predictions
from wibam_core.formats.rig import read_rig, write_rig
from wibam_core.formats.timestamps import read_timestamps, write_timestamps
from wibam_core.formats.tracks import read_tracks, write_tracks
from wibam_core.formats.usual import read_usual, write_usual
from wibam_core.formats.vehicles3d import read_vehicles3d, write_vehicles3d

_ANNOTATIONS = own_format(read_annotations, write_annotations)
_DETECTIONS = own_format(read_detections, write_detections)
_INSTANTS = own_format(read_instants, write_instants)
_RIG = own_format(read_rig, write_rig, JSON)
_BOXES_3D = own_format(read_vehicles3d, write_vehicles3d)

PROBE: Final = Artifact("probe", "preflight", "probe.json", "The recordings", document(Probe))
TIMESTAMPS: Final = Artifact(
    "timestamps",
    "preflight",
    "timestamps.parquet",
    "Times of all frames of the recordings",
    own_format(read_timestamps, write_timestamps),
)
LIMITS: Final = Artifact("limits", "preflight", "limits.json", "What the clocks must allow", document(Limits))
CLOCKS: Final = Artifact(
    "clocks", "sync", "clocks.json", "The cameras' clocks", own_format(read_clocks, write_clocks, JSON)
)
CHANGES: Final = Artifact("changes", "sync", "changes.json", "Light changes", document(Synchronisation))
CALIBRATED_RIG: Final = Artifact("calibrated-rig", "calibrate", "rig.json", "The cameras as calibrated", _RIG)
RESIDUALS: Final = Artifact(
    "residuals", "calibrate", "residuals.json", "Residuals of the calibration", document(CalibrationResiduals)
)
FRAMES: Final = Artifact(
    "frames",
    "frames",
    "frames",
    "Frames of all cameras",
    Codec(BINARY, FrameStore, None, FrameStore.__module__),
    version=2,
)
DETECTIONS: Final = Artifact("detections", "detect", "detections.parquet", "2D boxes by frame", _DETECTIONS, version=2)
BACKGROUND_DETECTIONS: Final = Artifact(
    "background-detections",
    "detect",
    "background.parquet",
    "2D boxes at first look, in the frames that show the still backgrounds",
    _DETECTIONS,
    optional=True,
)
SEARCHED_INSTANTS: Final = Artifact(
    "searched-instants",
    "detect",
    "searched.parquet",
    "The instants that were searched for vehicles",
    _INSTANTS,
)
DETECTION_STATISTICS: Final = Artifact(
    "detection-statistics", "detect", "statistics.json", "Counts of 2D boxes", document(DetectionStatistics)
)
DETECTOR_RIG: Final = Artifact(
    "detector-rig", "rounds", "rig.json", "The cameras as the detector's boxes alone refine them", _RIG, optional=True
)
DETECTOR_REFINEMENT: Final = Artifact(
    "detector-refinement",
    "rounds",
    "refinement.json",
    "What the detector's boxes alone say of the cameras",
    document(Refinement),
    optional=True,
)
ROUND_DETECTIONS: Final = Artifact(
    "round-detections",
    "rounds",
    "detections.parquet",
    "2D boxes by frame, after all rounds",
    _DETECTIONS,
    version=2,
)
ROUNDS: Final = Artifact("rounds", "rounds", "rounds.json", "What each round gained", document(Rounds))
RIG: Final = Artifact("rig", "refine", "rig.json", "The cameras as they are used", _RIG)
REFINEMENT: Final = Artifact(
    "refinement", "refine", "refinement.json", "What the traffic says of the cameras", document(Refinement)
)
ANNOTATIONS: Final = Artifact(
    "annotations",
    "associate",
    "annotations.parquet",
    "2D boxes with the vehicles that they belong to",
    own_format(read_annotations, write_annotations),
)
ASSOCIATION_STATISTICS: Final = Artifact(
    "association-statistics", "associate", "statistics.json", "Counts of vehicles", document(AssociationStatistics)
)
SPLIT: Final = Artifact("split", "dataset", "split.json", "The split in time", document(Split))
DATASET_STATISTICS: Final = Artifact(
    "dataset-statistics", "dataset", "statistics.json", "Distributions of the data set", document(DatasetStatistics)
)
FITS: Final = Artifact("fits", "lift", "fits.parquet", "7DoF fits to all views", _BOXES_3D)
LIFT_STATISTICS: Final = Artifact(
    "lift-statistics", "lift", "statistics.json", "Counts and residuals of the fits", document(LiftStatistics)
)
WEIGHTS: Final = Artifact("weights", "finetune", "weights.safetensors", "The fine-tuned network", opaque())
WEIGHTS_ONNX: Final = Artifact(
    "weights-onnx", "finetune", "weights.onnx", "The fine-tuned network as ONNX", opaque(), optional=True
)
CURVES: Final = Artifact("curves", "finetune", "curves.json", "Losses of the training", document(Curves))
PREDICTIONS: Final = Artifact(
    "predictions",
    "predict",
    "predictions.parquet",
    "3D boxes in the images of all cameras",
    Codec(PARQUET, Predictions, None, Predictions.__module__),
)
METRICS: Final = Artifact("metrics", "evaluate", "metrics.json", "How good the networks are", document(Metrics))
PREDICTIONS_BASELINE: Final = Artifact(
    "predictions-baseline",
    "evaluate",
    "predictions_baseline.parquet",
    "3D boxes before fine-tuning, in images of the test part",
    _BOXES_3D,
)
PREDICTIONS_FINETUNED: Final = Artifact(
    "predictions-finetuned",
    "evaluate",
    "predictions_finetuned.parquet",
    "3D boxes after fine-tuning, in images of the test part",
    _BOXES_3D,
)
TRACKS: Final = Artifact("tracks", "track", "tracks.parquet", "7DoF tracks", own_format(read_tracks, write_tracks))
USUAL: Final = Artifact(
    "usual",
    "track",
    "usual.npz",
    "Still backgrounds and usual scores",
    Codec(BINARY, read_usual, write_usual, read_usual.__module__),
    optional=True,
)
OPEN_TRACKS: Final = Artifact(
    "open-tracks", "track", "open.npz", "Tracks that more footage goes on with", opaque(), optional=True
)
WATCHED: Final = Artifact("watched", "track", "watched.json", "What a run noticed", document(Watched), optional=True)
CONFLICTS: Final = Artifact(
    "conflicts", "safety", "conflicts.json", "Conflicts between road users", document(Conflicts)
)
REPORT: Final = Artifact("report", "report", "report.html", "The report", text("text/html"))

#: By name.
ARTIFACTS: Mapping[str, Artifact[Any]] = MappingProxyType(
    {value.name: value for value in tuple(globals().values()) if isinstance(value, Artifact)}
)


def made_by(stage: str) -> tuple[Artifact[Any], ...]:
    """What a stage makes."""
    return tuple(artifact for artifact in ARTIFACTS.values() if artifact.stage == stage)
