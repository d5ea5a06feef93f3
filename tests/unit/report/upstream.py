"""What the other stages leave, written with their own code where that is quick."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from safetensors.numpy import save_file

from tests.builders import corner_rig
from tests.stage_folders import StageFolders
from tests.unit.report.documents import metrics_json
from tests.unit.report.scenes import boxes_at, crossing_traffic, noisy, paint
from wibam_core.artifacts import catalogue
from wibam_core.association.associate import association_statistics
from wibam_core.calibration.overlap import overlap_of
from wibam_core.calibration.residuals import Residuals
from wibam_core.clocks import SignalChange
from wibam_core.config import DatasetConfig, SafetyConfig
from wibam_core.dataset.split import split_in_time
from wibam_core.dataset.statistics import dataset_statistics
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.documents.curves import Curves, Epoch
from wibam_core.documents.metrics import Metrics
from wibam_core.documents.model_card import ModelCard
from wibam_core.documents.recordings import Probe, VideoInfo
from wibam_core.documents.refinement import Refinement
from wibam_core.documents.rounds import Rounds
from wibam_core.documents.statistics import DetectionStatistics, LiftStatistics, ResidualPercentiles
from wibam_core.formats.framestore import FrameStoreWriter
from wibam_core.formats.labels import write_labels
from wibam_core.formats.model_card import metadata_of
from wibam_core.geometry.projection import project_boxes
from wibam_core.road_users import CLASSES
from wibam_core.safety.conflicts import find_conflicts
from wibam_core.safety.document import conflicts_document
from wibam_core.scene import (
    AnnotatedInstant,
    CameraRig,
    Detections2D,
    LabelledInstant,
    MultiViewVehicle,
    Track,
    Vehicles3D,
)
from wibam_core.stages.graph import STAGES
from wibam_core.sync.document import sync_document
from wibam_core.sync.offsets import estimate_clocks

_OFFSETS_S = (0.0, 0.4, -0.7, 1.1)


def write_upstream(root: Path) -> tuple[StageFolders, Path]:
    """What all stages make of a painted crossroads, and its labels."""
    made = StageFolders(root)
    for stage in STAGES:
        made.seal(stage)
    rig, tracks = corner_rig(4), crossing_traffic()
    instants = [annotated(rig, tracks, int(t)) for t in sorted({int(t) for track in tracks for t in track.times_ns})]
    _give_cameras(made, rig)
    _give_changes(made, tuple(rig))
    small = {camera_id: camera.resized(320, 180) for camera_id, camera in rig.items()}
    with FrameStoreWriter(made.place(catalogue.FRAMES), 90) as store:
        for instant in instants:
            boxes, _, _ = boxes_at(tracks, instant.time_ns)
            for camera_id, camera in small.items():
                store.add(camera_id, instant.time_ns, instant.time_ns, paint(camera, boxes))
        store.close(dict.fromkeys(rig, (640, 360)))
    made.give(catalogue.ANNOTATIONS, instants)
    association = association_statistics(instants)
    made.give(catalogue.ASSOCIATION_STATISTICS, association)
    counts = DetectionStatistics(
        frames=100, boxes=association.boxes, boxes_by_camera={}, boxes_by_class={}, unknown_classes=[]
    )
    made.give(catalogue.DETECTION_STATISTICS, counts)
    split = split_in_time(instants, DatasetConfig(train_share=0.4, val_share=0.2, gap_s=0.4))
    made.give(catalogue.SPLIT, split)
    made.give(catalogue.DATASET_STATISTICS, dataset_statistics(instants, rig, split))
    _give_learning(made)
    made.give(catalogue.METRICS, Metrics.model_validate(metrics_json()))
    for artifact, scale in ((catalogue.PREDICTIONS_BASELINE, 1.0), (catalogue.PREDICTIONS_FINETUNED, 0.25)):
        made.give(artifact, [predicted(rig, c, tracks, time, scale) for time in split.times_ns["test"] for c in rig])
    made.give(catalogue.TRACKS, tracks)
    config = SafetyConfig()
    made.give(catalogue.CONFLICTS, conflicts_document(find_conflicts(tracks, config), config))
    return made, _write_labels(root, rig, tracks)


def annotated(rig: CameraRig, tracks: list[Track], time_ns: int) -> AnnotatedInstant:
    """Exact 2D boxes of all vehicles in view, associated."""
    boxes, classes, ids = boxes_at(tracks, time_ns)
    detections, views = {}, [dict[str, int]() for _ in ids]
    for camera_id, camera in rig.items():
        seen = project_boxes(camera, boxes)
        rows = np.flatnonzero(np.isfinite(seen).all(axis=1))
        for index, row in enumerate(rows):
            views[row][camera_id] = index
        detections[camera_id] = Detections2D(camera_id, time_ns, seen[rows], np.full(len(rows), 0.9), classes[rows])
    vehicles = tuple(
        MultiViewVehicle(k, int(ids[k]), CLASSES[int(classes[k])], float(boxes[k, 0]), float(boxes[k, 1]), views[k])
        for k in range(len(ids))
        if views[k]
    )
    return AnnotatedInstant(time_ns, detections, vehicles)


def predicted(rig: CameraRig, camera_id: str, tracks: list[Track], time_ns: int, scale: float) -> Vehicles3D:
    """What a network would say of one frame, with one doubtful box beside the good ones."""
    boxes, classes, _ = boxes_at(tracks, time_ns)
    seen = np.isfinite(project_boxes(rig[camera_id], boxes)).all(axis=1)
    found = noisy(boxes[seen], scale, time_ns % 1000)
    doubtful = np.array([[0.0, 0.0, 0.75, 4.0, 1.8, 1.5, 0.0]])
    scores = np.append(np.full(len(found), 0.8), 0.11)
    return Vehicles3D.of(
        time_ns, np.concatenate([found, doubtful]), np.append(classes[seen], 0), scores=scores, camera_id=camera_id
    )


def _give_cameras(made: StageFolders, rig: CameraRig) -> None:
    made.give(catalogue.RIG, rig)
    world = np.array([[x, y, 0.0] for x in (-4.0, 0.0, 4.0) for y in (-4.0, 0.0, 4.0)])
    pixels = {camera_id: camera.project(world)[0] + 0.5 for camera_id, camera in rig.items()}
    residuals = {c: Residuals.of("pnp", camera, world, pixels[c]).document() for c, camera in rig.items()}
    made.give(catalogue.RESIDUALS, CalibrationResiduals(cameras=residuals, overlap=overlap_of(rig)))
    made.give(catalogue.REFINEMENT, Refinement(method="none", taken=False, reason="refine.method is none"))
    info = VideoInfo(
        codec="h264",
        container="mov",
        width_px=640,
        height_px=360,
        rotation_deg=0,
        fps=25.0,
        first_ns=0,
        last_ns=10_000_000_000,
        duration_s=10.04,
        largest_gap_s=0.08,
        frames=250,
        missing_frames=0,
        variable_rate=False,
    )
    made.give(catalogue.PROBE, Probe(cameras=dict.fromkeys(rig, info)))


def _give_changes(made: StageFolders, camera_ids: tuple[str, ...]) -> None:
    """Light changes without a rhythm, so that every camera's offset is plain."""
    states = ("green", "amber", "red")
    times = np.cumsum(np.random.default_rng(0).uniform(5, 30, 12))
    changes = {
        camera_id: [
            SignalChange(
                camera_id,
                "A",
                time_ns=round((t - offset) * 1e9),
                before=states[k % 3],
                after=states[(k + 1) % 3],
                half_interval_ns=20_000_000,
            )
            for k, t in enumerate(times)
        ]
        for camera_id, offset in zip(camera_ids, _OFFSETS_S, strict=True)
    }
    made.give(catalogue.CHANGES, sync_document(changes, estimate_clocks(changes, camera_ids[0])))


def _give_learning(made: StageFolders) -> None:
    made.give(catalogue.ROUNDS, Rounds(rounds=[], kept=0, reason="no round was asked for"))
    residual = ResidualPercentiles(p10=0.01, p50=0.05, p90=0.2)
    made.give(catalogue.LIFT_STATISTICS, LiftStatistics(fits=120, kept=90, tracks=6, residual=residual))
    epochs = [
        Epoch(
            step=50 * k,
            learning_rate=1e-3,
            train={"heatmap": 1 / k, "size": 0.5 / k, "total": 1.5 / k},
            validation={"total": 1.7 / k},
        )
        for k in (1, 2, 3)
    ]
    made.give(catalogue.CURVES, Curves(kept="last", kept_step=150, epochs=epochs))
    card = ModelCard(family="any", classes=("car",), decode="plane", method="lifted", input_width_px=704)
    save_file({"any": np.zeros(1)}, made.place(catalogue.WEIGHTS), metadata_of(card))


def _write_labels(root: Path, rig: CameraRig, tracks: list[Track]) -> Path:
    labelled = []
    for time_ns in sorted({int(t) for track in tracks for t in track.times_ns}):
        boxes, classes, ids = boxes_at(tracks, time_ns)
        visibility = {camera_id: np.ones(len(boxes)) for camera_id in rig}
        labelled.append(LabelledInstant(Vehicles3D.of(time_ns, boxes, classes, ids), visibility))
    write_labels(root / "labels.parquet", labelled)
    return root / "labels.parquet"
