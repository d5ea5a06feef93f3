"""Detection in two looks: every box again, against what its camera shows without vehicles.

A frame is read and decoded once for both.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import groupby, repeat

from wibam_core.config import DetectConfig
from wibam_core.detection.background import BackgroundFrames, StillBackground, still_background
from wibam_core.detection.boxes import Found, Image, IntArray
from wibam_core.detection.edge_refiner import EdgeRefiner
from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.pixels import scale_of
from wibam_core.progress import Progress
from wibam_core.scene import Boxes2D, CameraRig, FrameKey

#: Camera id -> which frames show its background.
Shown = Mapping[str, BackgroundFrames]
#: What is detected in an image, which is that of a frame, px of the recording.
FirstLook = Callable[[FrameKey, Image], Boxes2D]


def backgrounds_shown(
    store: FrameStore, times_ns: Mapping[str, IntArray], background_s: float, rig: CameraRig | None
) -> dict[str, BackgroundFrames]:
    """Which frames show the background of each camera that the store has frames of.

    Args:
        store: holds the frames.
        times_ns: camera -> (N,) times of all frames of its recording, on its own clock.
        background_s: about how long one background lasts.
        rig: says which camera a view of a wide lens belongs to; None where there is none.
    """
    return {
        camera_id: BackgroundFrames(
            times_ns[camera_id if rig is None else rig.mounted_id(camera_id)], store.stored_ns(camera_id), background_s
        )
        for camera_id in store.camera_ids
    }


def background_frames(frames: Iterable[FrameKey], shown: Shown) -> list[FrameKey]:
    """The frames that the backgrounds of frames are made of."""
    blocks = sorted({(frame.camera_id, shown[frame.camera_id].block(frame.local_ns)) for frame in frames})
    return [FrameKey(camera_id, ns) for camera_id, block in blocks for ns in shown[camera_id].of_block(block)]


def look_again(
    store: FrameStore,
    frames: Sequence[FrameKey],
    known_looks: Mapping[FrameKey, Boxes2D],
    first_look: FirstLook,
    shown: Shown,
    config: DetectConfig,
    progress: Progress,
) -> Iterator[tuple[FrameKey, Boxes2D]]:
    """The frames with sharper boxes, a result that depends on no other frame than those of their backgrounds.

    Args:
        store: holds the images.
        frames: which.
        known_looks: what was detected in the frames of their backgrounds, and in any others, px of the recording.
        first_look: asked for what it does not hold.
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
        return still_background(images, [store.to_stored_px(camera_id, known_looks[frame].boxes) for frame in there])

    done = 0
    with ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0))) as pool:
        for block, group in groupby(sorted(frames, key=block_of), key=block_of):
            of_block = list(group)
            cameras = sorted({frame.camera_id for frame in of_block})
            backgrounds = dict(zip(cameras, pool.map(background, cameras, repeat(block)), strict=True))
            refine = partial(_refined, store, refiner, backgrounds, known_looks, first_look, config)
            for frame, boxes in zip(of_block, pool.map(refine, of_block), strict=True):
                yield frame, boxes
                done += 1
                if done % 200 == 0 or done == len(frames):
                    progress(done / len(frames), f"{done} of {len(frames)} frames")


def _refined(
    store: FrameStore,
    refiner: EdgeRefiner,
    backgrounds: Mapping[str, StillBackground],
    known_looks: Mapping[FrameKey, Boxes2D],
    first_look: FirstLook,
    config: DetectConfig,
    frame: FrameKey,
) -> Boxes2D:
    camera_id, image = frame.camera_id, store.image_at(*frame)
    seen = known_looks[frame] if frame in known_looks else first_look(frame, image)
    found = refiner.refine(
        image,
        backgrounds[camera_id],
        Found(store.to_stored_px(camera_id, seen.boxes), seen.scores, seen.classes),
        nms_iou=config.nms_iou,
        classify=config.detector == "bundled",  # other detectors know vehicles from more than simulation
    )
    native, amodal = (store.to_native_px(camera_id, edges) for edges in (found.boxes, found.amodal_boxes))
    scale = scale_of(store.size(camera_id), store.native_size(camera_id), 4)
    return Boxes2D(native, found.scores, found.classes, amodal, found.amodal_sd * scale)
