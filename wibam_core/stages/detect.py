"""Detect vehicles in frames a few times a second, in pixels of the recording."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

from wibam_core.artifacts.catalogue import DETECTION_STATISTICS, DETECTIONS, FRAMES
from wibam_core.config import DetectConfig
from wibam_core.detection.detector import BUNDLED, Detector, load_detector
from wibam_core.detection.statistics import detection_statistics
from wibam_core.errors import NoVehicles
from wibam_core.formats.framestore import FrameStore
from wibam_core.progress import Progress, part
from wibam_core.scene import AnnotatedInstant, Detections2D, FrameSet
from wibam_core.stages.base import StageContext, Summary
from wibam_core.stages.edges import refine_all

#: Instants that are in work at one time.
_CHUNK = 16


def run(context: StageContext, config: DetectConfig) -> Summary:
    """Write `DETECTIONS`, 2D boxes at ``config.rate_hz`` without multi-view vehicles yet, and `DETECTION_STATISTICS`.

    Raises:
        InvalidWeights: a detector of one's own cannot be used.
        NoVehicles: no frame of any camera shows a vehicle.
    """
    detector = _detector(context, config)
    store = context.read(FRAMES)
    refined = config.refine == "on" or (config.refine == "auto" and config.detector == "bundled")
    frame_sets = store.thinned(config.rate_hz)
    instants = list(_detect_all(store, frame_sets, detector, part(context.progress, 0.0, 0.5 if refined else 1.0)))
    frames = sum(len(instant.detections) for instant in instants)
    if not any(len(seen) for instant in instants for seen in instant.detections.values()):
        raise NoVehicles(f"no vehicle was detected in {frames} frames of {len(store.camera_ids)} cameras")
    if refined:
        instants = list(refine_all(store, instants, config, part(context.progress, 0.5, 1.0)))
    statistics = detection_statistics(instants, store.camera_ids)
    context.write(DETECTIONS, instants)
    context.write(DETECTION_STATISTICS, statistics)
    return statistics.model_dump()


def _detector(context: StageContext, config: DetectConfig) -> Detector:
    path = context.assets["detector"] if config.detector == "custom" else BUNDLED
    return load_detector(path, min_score=config.min_score, nms_iou=config.nms_iou)


def _detect_all(
    store: FrameStore, frame_sets: Sequence[FrameSet], detector: Detector, progress: Progress
) -> Iterator[AnnotatedInstant]:
    """The instants in order; several images side by side, each on one thread."""

    def detect(frame_set: FrameSet) -> AnnotatedInstant:
        return AnnotatedInstant(
            frame_set.time_ns,
            {
                camera_id: _detect(store, detector, camera_id, frame_set.time_ns, frame_time_ns)
                for camera_id, frame_time_ns in sorted(frame_set.frame_times_ns.items())
            },
        )

    total = len(frame_sets)
    with ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0))) as pool:
        for start in range(0, total, _CHUNK):
            yield from pool.map(detect, frame_sets[start : start + _CHUNK])
            done = min(start + _CHUNK, total)
            progress(done / total, f"{done} of {total} instants")


def _detect(store: FrameStore, detector: Detector, camera_id: str, time_ns: int, frame_time_ns: int) -> Detections2D:
    found = detector.detect(store.image(camera_id, time_ns))
    boxes = store.to_native_px(camera_id, found.boxes)
    return Detections2D(camera_id, frame_time_ns, boxes, found.scores, found.classes)
