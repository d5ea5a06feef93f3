"""Detect vehicles in frames a few times a second, in pixels of the recording."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial

import numpy as np

from wibam_core.artifacts.artifact import Artifact
from wibam_core.artifacts.catalogue import (
    BACKGROUND_DETECTIONS,
    CALIBRATED_RIG,
    DETECTION_STATISTICS,
    DETECTIONS,
    FRAMES,
    SEARCHED_INSTANTS,
    TIMESTAMPS,
)
from wibam_core.config import DetectConfig
from wibam_core.detection.boxes import Image
from wibam_core.detection.detector import BUNDLED, load_detector
from wibam_core.detection.family import Detector
from wibam_core.detection.instants import annotated, frames_of
from wibam_core.detection.one_per_camera import seen_once
from wibam_core.detection.second_look import FirstLook, background_frames, backgrounds_shown, look_again
from wibam_core.detection.statistics import detection_statistics
from wibam_core.detection.tiles import TiledDetector
from wibam_core.errors import InputError
from wibam_core.formats.framestore import FrameStore
from wibam_core.progress import Progress, part
from wibam_core.scene import Boxes2D, FrameKey
from wibam_core.stages.base import StageContext, Summary

#: Frames that are in work at one time.
_CHUNK = 64


def run(context: StageContext, config: DetectConfig) -> Summary:
    """Write what is seen in the frames of the instants, thinned to ``config.rate_hz``. Only new ones are searched.

    Views of a wide lens are searched one by one; what two of one camera show is kept in the one that shows it best.

    That is `DETECTIONS`, 2D boxes by frame, `SEARCHED_INSTANTS`, which of the instants they belong to,
    `DETECTION_STATISTICS`, and, where boxes were looked at a second time, `BACKGROUND_DETECTIONS`. A detector that
    finds nothing at all is no error yet: the rounds look for what moves.

    Raises:
        InvalidWeights: a detector of one's own cannot be used.
    """
    detector = _detector(context, config)
    store = context.read(FRAMES)
    refined = config.refine == "on" or (config.refine == "auto" and config.detector == "bundled")
    instants = store.thinned(config.rate_hz)
    frames = frames_of(instants)
    rig = context.read(CALIBRATED_RIG) if any(camera.is_wide for camera in context.site.cameras) else None
    shown, of_backgrounds = {}, []
    if refined:
        times_ns = context.read(TIMESTAMPS)
        shown = backgrounds_shown(store, times_ns, config.background_s, rig)
        of_backgrounds = background_frames(frames, shown)
    known = _known(context, DETECTIONS, frames)
    looks = _known(context, BACKGROUND_DETECTIONS, of_backgrounds)
    missing = [frame for frame in frames if frame not in known]
    first_look = partial(_first_look, store, detector)
    if refined:
        to_search = [frame for frame in of_backgrounds if frame not in looks]
        share = len(to_search) / max(len(to_search) + len(missing), 1)
        searching, looking = part(context.progress, 0.0, share), part(context.progress, share, 1.0)
        looks |= _search_all(store, to_search, first_look, searching)
        seen = known | dict(look_again(store, missing, looks, first_look, shown, config, looking))
    else:
        seen = known | dict(_search_all(store, missing, first_look, context.progress))
    if refined:
        context.write(BACKGROUND_DETECTIONS, {frame: looks[frame] for frame in of_backgrounds})
    detected = {frame: seen[frame] for frame in frames}
    if rig is not None:
        detected = seen_once(detected, rig)
    context.progress(1.0, f"{len(missing)} of {len(frames)} frames were new")
    context.write(DETECTIONS, detected)
    context.write(SEARCHED_INSTANTS, instants)
    statistics = detection_statistics(annotated(instants, detected), store.camera_ids, detector.classes)
    context.write(DETECTION_STATISTICS, statistics)
    return statistics.model_dump()


def _known(
    context: StageContext, artifact: Artifact[dict[FrameKey, Boxes2D]], frames: Iterable[FrameKey]
) -> dict[FrameKey, Boxes2D]:
    """What earlier outputs hold of the frames."""
    known: dict[FrameKey, Boxes2D] = {}
    wanted = set(frames)
    for outputs in context.earlier:
        if not wanted:
            break
        with suppress(InputError):  # it was removed meanwhile
            there = outputs.read(artifact)
            known |= {frame: there[frame] for frame in wanted & there.keys()}
            wanted -= there.keys()
    return known


def _detector(context: StageContext, config: DetectConfig) -> Detector:
    path = context.assets["detector"] if config.detector == "custom" else BUNDLED
    detector = load_detector(path, min_score=config.min_score, nms_iou=config.nms_iou)
    return detector if config.tiles == 1 else TiledDetector(detector, config.tiles, config.nms_iou)


def _search_all(
    store: FrameStore, frames: Sequence[FrameKey], first_look: FirstLook, progress: Progress
) -> Iterator[tuple[FrameKey, Boxes2D]]:
    """The frames in order with a first look at each; several side by side, each on one thread."""

    def searched(frame: FrameKey) -> Boxes2D:
        return first_look(frame, store.image_at(*frame))

    with ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0))) as pool:
        for start in range(0, len(frames), _CHUNK):
            chunk = frames[start : start + _CHUNK]
            yield from zip(chunk, pool.map(searched, chunk), strict=True)
            done = start + len(chunk)
            progress(done / len(frames), f"{done} of {len(frames)} frames")


def _first_look(store: FrameStore, detector: Detector, frame: FrameKey, image: Image) -> Boxes2D:
    found = detector.detect(image)
    unknown = np.full((len(found.boxes), 4), np.nan)
    return Boxes2D(store.to_native_px(frame.camera_id, found.boxes), found.scores, found.classes, unknown, unknown)
