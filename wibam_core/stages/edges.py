"""The second half of detection: every box again, against what its camera shows without vehicles."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np

from wibam_core.config import DetectConfig
from wibam_core.detection.background import StillBackground, still_background
from wibam_core.detection.boxes import Found
from wibam_core.detection.refine import EdgeRefiner
from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.pixels import scale_of
from wibam_core.progress import Progress
from wibam_core.scene import AnnotatedInstant, Detections2D

#: A background is made of so many frames.
_FRAMES = 32


def refine_all(
    store: FrameStore, instants: Sequence[AnnotatedInstant], config: DetectConfig, progress: Progress
) -> Iterator[AnnotatedInstant]:
    """The instants, in order, with sharper boxes.

    Args:
        store: the frames of the instants.
        instants: with detections, no vehicles yet; ascending.
        config: which detector it was, how long a background lasts, and what counts as found twice.
        progress: told now and then.
    """
    refiner = EdgeRefiner()
    done = 0
    with ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0))) as pool:
        for block in _blocks(instants, config.background_s):
            cameras = sorted({camera_id for instant in block for camera_id in instant.detections})
            backgrounds = dict(zip(cameras, pool.map(partial(_background, store, block), cameras), strict=True))
            for instant in pool.map(partial(_refined, store, refiner, backgrounds, config), block):
                yield instant
                done += 1
                if done % 50 == 0 or done == len(instants):
                    progress(done / len(instants), f"edges: {done} of {len(instants)} instants")


def _blocks(instants: Sequence[AnnotatedInstant], block_s: float) -> list[list[AnnotatedInstant]]:
    """Consecutive instants, in blocks of equal duration, of about ``block_s``."""
    duration_s = (instants[-1].time_ns - instants[0].time_ns) * 1e-9
    count = max(1, round(duration_s / block_s))
    blocks: list[list[AnnotatedInstant]] = [[] for _ in range(count)]
    for instant in instants:
        share = (instant.time_ns - instants[0].time_ns) * 1e-9 / max(duration_s, 1e-9)
        blocks[min(int(share * count), count - 1)].append(instant)
    return [block for block in blocks if block]


def _background(store: FrameStore, block: Sequence[AnnotatedInstant], camera_id: str) -> StillBackground:
    there = [instant for instant in block if camera_id in instant.detections]
    places = np.linspace(0, len(there) - 1, min(len(there), _FRAMES)).round().astype(int)
    chosen = [there[place] for place in np.unique(places).tolist()]
    images = [store.image(camera_id, instant.time_ns) for instant in chosen]
    boxes = [store.to_stored_px(camera_id, instant.detections[camera_id].boxes) for instant in chosen]
    return still_background(images, boxes)


def _refined(
    store: FrameStore,
    refiner: EdgeRefiner,
    backgrounds: Mapping[str, StillBackground],
    config: DetectConfig,
    instant: AnnotatedInstant,
) -> AnnotatedInstant:
    def refine(seen: Detections2D) -> Detections2D:
        image = store.image(seen.camera_id, instant.time_ns)
        boxes = store.to_stored_px(seen.camera_id, seen.boxes)
        found = refiner.refine(
            image,
            backgrounds[seen.camera_id],
            Found(boxes, seen.scores, seen.classes),
            nms_iou=config.nms_iou,
            classify=config.detector == "bundled",  # other detectors know vehicles from more than simulation
        )
        native, amodal = (store.to_native_px(seen.camera_id, edges) for edges in (found.boxes, found.amodal_boxes))
        scale = scale_of(store.size(seen.camera_id), store.native_size(seen.camera_id), 4)
        return replace(
            seen,
            boxes=native,
            scores=found.scores,
            classes=found.classes,
            amodal_boxes=amodal,
            amodal_sd=found.amodal_sd * scale,
        )

    return AnnotatedInstant(instant.time_ns, {id_: refine(seen) for id_, seen in instant.detections.items()})
