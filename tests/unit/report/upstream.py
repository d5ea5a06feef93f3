"""Folders as the other stages leave them, written with their own code where that is quick."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tests.builders import corner_rig
from tests.unit.report.scenes import boxes_at, crossing_traffic, metrics_json, noisy, paint
from wibam_core.association.associate import association_statistics
from wibam_core.calibration.residuals import Residuals
from wibam_core.config import DatasetConfig, SafetyConfig
from wibam_core.dataset.split import split_in_time
from wibam_core.dataset.statistics import dataset_statistics
from wibam_core.formats.annotations import write_annotations
from wibam_core.formats.framestore import FrameStoreWriter
from wibam_core.formats.labels import write_labels
from wibam_core.formats.rig import write_rig
from wibam_core.formats.tracks import write_tracks
from wibam_core.formats.vehicles3d import write_vehicles3d
from wibam_core.geometry.projection import project_boxes
from wibam_core.road_users import CLASSES
from wibam_core.safety.conflicts import find_conflicts
from wibam_core.scene import (
    AnnotatedInstant,
    CameraRig,
    Detections2D,
    LabelledInstant,
    MultiViewVehicle,
    SignalChange,
    Track,
    Vehicles3D,
)
from wibam_core.stages.safety import to_json
from wibam_core.sync.document import sync_document
from wibam_core.sync.offsets import estimate_clocks
from wibam_core.training.finetune import Epoch
from wibam_core.video.probe import VideoInfo

STAGES = (
    "preflight",
    "sync",
    "calibrate",
    "frames",
    "detect",
    "associate",
    "dataset",
    "lift",
    "finetune",
    "evaluate",
    "track",
    "safety",
)
_OFFSETS_S = (0.0, 0.4, -0.7, 1.1)


def write_upstream(root: Path) -> tuple[dict[str, Path], Path]:
    """All stages' folders of a painted crossroads, and its labels."""
    folders = {stage: root / stage for stage in STAGES}
    for stage, folder in folders.items():
        folder.mkdir(parents=True)
        _json(
            folder / "manifest.json", {"stage": stage, "digest": "5e" * 32, "seconds": 1.5, "summary": {}, "files": {}}
        )
    rig, tracks = corner_rig(4), crossing_traffic()
    instants = [annotated(rig, tracks, int(t)) for t in sorted({int(t) for track in tracks for t in track.times_ns})]
    _write_cameras(folders, rig)
    _write_changes(folders["sync"], tuple(rig))
    small = {camera_id: camera.resized(320, 180) for camera_id, camera in rig.items()}
    with FrameStoreWriter(folders["frames"], 90) as store:
        for instant in instants:
            boxes, _, _ = boxes_at(tracks, instant.time_ns)
            for camera_id, camera in small.items():
                store.add(camera_id, instant.time_ns, instant.time_ns, paint(camera, boxes))
        store.close(dict.fromkeys(rig, (640, 360)))
    write_annotations(folders["associate"] / "annotations.parquet", instants)
    _json(folders["associate"] / "statistics.json", association_statistics(instants))
    split = split_in_time(instants, DatasetConfig(train_share=0.4, val_share=0.2, gap_s=0.4))
    _json(folders["dataset"] / "split.json", split.to_json())
    _json(folders["dataset"] / "statistics.json", dataset_statistics(instants, rig, split))
    _write_learning(folders)
    _json(folders["evaluate"] / "metrics.json", metrics_json())
    for name, scale in (("baseline", 1.0), ("finetuned", 0.25)):
        found = [predicted(rig, c, tracks, time, scale) for time in split.times_ns["test"] for c in rig]
        write_vehicles3d(folders["evaluate"] / f"predictions_{name}.parquet", found)
    write_tracks(folders["track"] / "tracks.parquet", tracks)
    config = SafetyConfig()
    conflicts = [to_json(number, conflict) for number, conflict in enumerate(find_conflicts(tracks, config))]
    _json(folders["safety"] / "conflicts.json", {"thresholds": config.model_dump(), "conflicts": conflicts})
    return folders, _write_labels(root, rig, tracks)


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


def _write_cameras(folders: dict[str, Path], rig: CameraRig) -> None:
    write_rig(folders["calibrate"] / "rig.json", rig)
    world = np.array([[x, y, 0.0] for x in (-4.0, 0.0, 4.0) for y in (-4.0, 0.0, 4.0)])
    pixels = {camera_id: camera.project(world)[0] + 0.5 for camera_id, camera in rig.items()}
    documents = {c: Residuals.of("pnp", camera, world, pixels[c]).document() for c, camera in rig.items()}
    _json(folders["calibrate"] / "residuals.json", documents)
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
    _json(folders["preflight"] / "probe.json", dict.fromkeys(rig, asdict(info)))


def _write_changes(folder: Path, camera_ids: tuple[str, ...]) -> None:
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
    _json(folder / "changes.json", sync_document(changes, estimate_clocks(changes, camera_ids[0])))


def _write_learning(folders: dict[str, Path]) -> None:
    _json(folders["lift"] / "statistics.json", {"fits": 120, "kept": 90, "tracks": 6, "residual": {"p50": 0.05}})
    epochs = [
        Epoch(50 * k, 1e-3, {"heatmap": 1 / k, "size": 0.5 / k, "total": 1.5 / k}, {"total": 1.7 / k})
        for k in (1, 2, 3)
    ]
    curves = {"method": "lifted", "decode": "plane", "input_width_px": 704, "kept": "last", "kept_step": 150}
    _json(folders["finetune"] / "curves.json", curves | {"epochs": [asdict(epoch) for epoch in epochs]})


def _write_labels(root: Path, rig: CameraRig, tracks: list[Track]) -> Path:
    labelled = []
    for time_ns in sorted({int(t) for track in tracks for t in track.times_ns}):
        boxes, classes, ids = boxes_at(tracks, time_ns)
        visibility = {camera_id: np.ones(len(boxes)) for camera_id in rig}
        labelled.append(LabelledInstant(Vehicles3D.of(time_ns, boxes, classes, ids), visibility))
    write_labels(root / "labels.parquet", labelled)
    return root / "labels.parquet"


def _json(path: Path, document: Any) -> None:
    path.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")
