"""The second half of detection: every box again, against what its camera shows without vehicles."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import groupby, repeat

from wibam_core.config import DetectConfig
from wibam_core.detection.background import BackgroundFrames, StillBackground, still_background
from wibam_core.detection.boxes import Found
from wibam_core.detection.edge_refiner import EdgeRefiner
from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.pixels import scale_of
from wibam_core.progress import Progress
from wibam_core.scene import Boxes2D, FrameKey

#: Camera id -> which frames show its background.
Shown = Mapping[str, BackgroundFrames]


def background_frames(frames: Iterable[FrameKey], shown: Shown) -> list[FrameKey]:
    """The frames that the backgrounds of frames are made of."""
    blocks = sorted({(frame.camera_id, shown[frame.camera_id].block(frame.local_ns)) for frame in frames})
    return [FrameKey(camera_id, ns) for camera_id, block in blocks for ns in shown[camera_id].of_block(block)]


def look_again(
    store: FrameStore,
    frames: Sequence[FrameKey],
    first_looks: Mapping[FrameKey, Boxes2D],
    shown: Shown,
    config: DetectConfig,
    progress: Progress,
) -> Iterator[tuple[FrameKey, Boxes2D]]:
    """The frames with sharper boxes, a result that depends on no other frame than those of their backgrounds.

    Args:
        store: holds the images.
        frames: which.
        first_looks: what was detected in them and in the frames of their backgrounds, px of the recording.
        shown: camera id -> which frames show its background.
        config: which detector it was, and what counts as found twice.
        progress: told now and then.
    """
    refiner = EdgeRefiner()

    def block_of(frame: FrameKey) -> int:
        return shown[frame.camera_id].block(frame.local_ns)

    def background(camera_id: str, block: int) -> StillBackground:
        there = [FrameKey(camera_id, local_ns) for local_ns in shown[camera_id].of_block(block)]
        images = [store.image_at(*frame) for frame in there]
        return still_background(images, [store.to_stored_px(camera_id, first_looks[frame].boxes) for frame in there])

    done = 0
    with ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0))) as pool:
        for block, group in groupby(sorted(frames, key=block_of), key=block_of):
            of_block = list(group)
            cameras = sorted({frame.camera_id for frame in of_block})
            backgrounds = dict(zip(cameras, pool.map(background, cameras, repeat(block)), strict=True))
            refine = partial(_refined, store, refiner, backgrounds, first_looks, config)
            for frame, boxes in zip(of_block, pool.map(refine, of_block), strict=True):
                yield frame, boxes
                done += 1
                if done % 200 == 0 or done == len(frames):
                    progress(done / len(frames), f"edges: {done} of {len(frames)} frames")


def _refined(
    store: FrameStore,
    refiner: EdgeRefiner,
    backgrounds: Mapping[str, StillBackground],
    first_looks: Mapping[FrameKey, Boxes2D],
    config: DetectConfig,
    frame: FrameKey,
) -> Boxes2D:
    camera_id, seen = frame.camera_id, first_looks[frame]
    found = refiner.refine(
        store.image_at(*frame),
        backgrounds[camera_id],
        Found(store.to_stored_px(camera_id, seen.boxes), seen.scores, seen.classes),
        nms_iou=config.nms_iou,
        classify=config.detector == "bundled",  # other detectors know vehicles from more than simulation
    )
    native, amodal = (store.to_native_px(camera_id, edges) for edges in (found.boxes, found.amodal_boxes))
    scale = scale_of(store.size(camera_id), store.native_size(camera_id), 4)
    return Boxes2D(native, found.scores, found.classes, amodal, found.amodal_sd * scale)
