"""What moves, beside what a detector found: candidates for vehicles that no network has to know.

A silhouette is taken for a vehicle where it is as large as one that stands on the ground at its place. It is added
where the detector has no box of it, and takes the place of a box where it holds that one alone: a detector that
overlooks much often shows a part of what it finds. One that holds several boxes is several vehicles in a row, whose
boxes stay. Every silhouette is looked at again beside the still background, as boxes of the bundled detector are.

Boxes of the detector on scenery (`rounds.scenery`) hide nothing of a background, and no silhouette that passes in front
of them. Which silhouettes, and which boxes on scenery, are vehicles, several cameras decide (`rounds.settled`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wibam_core.detection.background import StillBackground, still_background
from wibam_core.detection.boxes import Found, Image
from wibam_core.detection.edge_refiner import EdgeRefiner
from wibam_core.detection.instants import frames_of
from wibam_core.detection.moving import Stillness, resized_mask
from wibam_core.detection.one_per_camera import seen_once
from wibam_core.geometry.boxes2d import areas_px2, image_iou, intersections_px2, non_maximum_suppression
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane
from wibam_core.geometry.outlines import outlines
from wibam_core.geometry.pixels import scale_of
from wibam_core.progress import Progress, silent
from wibam_core.road_users import BODIES, VULNERABLE, RoadUserClass
from wibam_core.rounds.scenery import Scenery, ToldApart
from wibam_core.rounds.seen import SAME_IOU
from wibam_core.rounds.world import Detected, World
from wibam_core.scene import Boxes2D, FloatArray, FrameKey

#: Length, width and height of the smallest vehicle that is looked for, and of the largest, m.
_SMALLEST, _LARGEST = (3.4, 1.6, 1.4), (14.0, 2.6, 3.8)
#: A silhouette covers at least this share of the smallest one's outline where it is seen from its narrowest side.
_LEAST_SHOWN = 0.5
#: Ways in which a vehicle may stand whose outlines are compared.
_YAWS = np.arange(4) * np.pi / 4
#: Backgrounds are made so often at most, each without what the one before showed to be no ground.
_PASSES = 3
#: A box and a silhouette show the same, too, where this share of one of them lies within the other.
_SAME_INSIDE = 0.6


class BesideWhatMoves(NamedTuple):
    """What a detector found, and what moves.

    Attributes:
        found: the detector's boxes and silhouettes of vehicles that move, in all frames, px of the recording.
        told_apart: the detector's.
        stills: what each camera shows without vehicles, by camera and number of the background; none where no round
            with a network may follow.
    """

    found: dict[FrameKey, Boxes2D]
    told_apart: ToldApart
    stills: Mapping[tuple[str, int], Still]


def beside_what_moves(world: World, detected: Detected, progress: Progress = silent) -> BesideWhatMoves:
    """What moves, beside what a detector found, as the module says.

    Silhouettes that the detector has no box of have the least score.

    Args:
        world: the recording.
        detected: what the detector found in the frames of the instants, px of the recording.
        progress: told now and then.
    """
    refiner = EdgeRefiner()
    frames = frames_of(world.instants)
    found: dict[FrameKey, Boxes2D] = {}
    stills: dict[tuple[str, int], Still] = {}
    on_scenery = {frame: np.zeros(len(detected[frame].boxes), dtype=bool) for frame in frames}
    with ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0))) as pool:
        for (camera_id, block), group in groupby(frames, key=partial(_block, world)):
            of_block = list(group)
            if not world.shown[camera_id].of_block(block):  # no frame shows the background then
                found |= {frame: detected[frame] for frame in of_block}
                continue
            still = Still.of(world, camera_id, block, detected)
            if world.options.rounds.most:  # else no network's boxes are looked at again
                stills[camera_id, block] = still.alone()
            add = partial(_with_silhouettes, world, refiner, still)
            own = pool.map(add, of_block, map(detected.__getitem__, of_block))
            for frame, (boxes, scenery) in zip(of_block, own, strict=True):
                found[frame], on_scenery[frame] = boxes, scenery
            progress(len(found) / len(frames), f"looking for what moves: {len(found)} of {len(frames)} frames")
    told_apart = ToldApart(
        trusted={frame: detected[frame].where(~rows) for frame, rows in on_scenery.items()},
        on_scenery={frame: detected[frame].where(rows) for frame, rows in on_scenery.items()},
    )
    return BesideWhatMoves(seen_once(found, world.rig) if world.rig.views else found, told_apart, stills)


def looked_at_again(
    world: World, stills: Mapping[tuple[str, int], Still], looked: Detected, progress: Progress = silent
) -> tuple[dict[FrameKey, Boxes2D], dict[FrameKey, Boxes2D]]:
    """Boxes of all frames with sharper edges, and those of them that lie on scenery.

    Args:
        world: the recording.
        stills: by camera and number of the background. Where one lacks, boxes stay as they are.
        looked: what was found in all frames of the instants, px of the recording.
        progress: told now and then.
    """
    refiner = EdgeRefiner()
    frames = frames_of(world.instants)

    def again(still: Still | None, frame: FrameKey) -> tuple[Boxes2D, Boxes2D]:
        seen = looked[frame]
        if still is None:
            return seen, seen.where(np.empty(0, dtype=np.int64))
        image = world.store.image_at(*frame)
        classify = world.options.detect.detector == "bundled"  # other detectors know more than simulation
        of = Found(seen.boxes, seen.scores, seen.classes)
        boxes = _looked_at(world, refiner, still, frame, image, of, classify)
        return boxes, boxes.where(still.scenery.holds(image, world.store.to_stored_px(frame.camera_id, boxes.boxes)))

    found: dict[FrameKey, Boxes2D] = {}
    on_scenery: dict[FrameKey, Boxes2D] = {}
    with ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0))) as pool:
        for block, group in groupby(frames, key=partial(_block, world)):
            of_block, still = list(group), stills.get(block)
            own = pool.map(partial(again, None if still is None else still.alone()), of_block)
            for frame, of in zip(of_block, own, strict=True):
                found[frame], on_scenery[frame] = of
            progress(len(found) / len(frames), f"looking again: {len(found)} of {len(frames)} frames")
    return (seen_once(found, world.rig) if world.rig.views else found), on_scenery


def _block(world: World, frame: FrameKey) -> tuple[str, int]:
    return frame.camera_id, world.shown[frame.camera_id].block(frame.local_ns)


class Still(NamedTuple):
    """What does not move before a camera: its scenery, and its view without vehicles."""

    scenery: Scenery
    background: StillBackground
    stillness: Stillness

    def alone(self) -> Still:
        """The same, sharing nothing that is computed when it is first used: to be kept."""
        return self._replace(background=StillBackground(self.background.image, self.background.known))

    @classmethod
    def of(cls, world: World, camera_id: str, block: int, detected: Detected) -> Still:
        """Vehicles that the detector overlooks are left out of the background, too.

        A background still has traces of these; what differs from it is left out of the next. One that stood there for
        most of the time is all that the first background shows of its place, until it drives off and uncovers the
        ground: then that decides.
        """
        there = [FrameKey(camera_id, local_ns) for local_ns in world.shown[camera_id].of_block(block)]
        images = [world.store.image_at(*frame) for frame in there]
        scenery = Scenery.of(images)
        boxes = []
        for frame, image in zip(there, images, strict=True):
            found = detected[frame].boxes if frame in detected else np.empty((0, 4))
            stored = world.store.to_stored_px(camera_id, found)
            boxes.append(stored[~scenery.holds(image, stored)])
        height, width = images[0].shape[:2]
        uncovered = [np.zeros((height, width), np.uint8) for _ in images]
        hidden = boxes
        background = still_background(images, hidden)
        for _ in range(_PASSES):
            stillness = Stillness.of(background, images, hidden, uncovered)
            told = [stillness.told_apart(image) for image in images]
            hidden = [np.concatenate([found, more]) for found, (more, _) in zip(boxes, told, strict=True)]
            for known, (_, more) in zip(uncovered, told, strict=True):
                known |= resized_mask(more, (width, height))
            background = still_background(images, hidden, uncovered)
            if not any(more.any() for _, more in told):
                break
        return cls(scenery, background, Stillness.of(background, images, hidden, uncovered))


def _with_silhouettes(
    world: World, refiner: EdgeRefiner, still: Still, frame: FrameKey, detected: Boxes2D
) -> tuple[Boxes2D, NDArray[np.bool_]]:
    """The detector's boxes of a frame with silhouettes, and which of the detector's (N,) lie on scenery."""
    store, camera = world.store, world.rig[frame.camera_id]
    image: Image = store.image_at(*frame)
    on_scenery = still.scenery.holds(image, store.to_stored_px(frame.camera_id, detected.boxes))
    known = detected.where(~on_scenery)
    boxes = store.to_native_px(frame.camera_id, still.stillness.silhouettes(image))
    boxes = boxes[np.flatnonzero(_as_large_as_vehicles(camera, boxes))]
    same = _same(boxes, known.boxes) & ~VULNERABLE[known.classes]  # nobody on foot is as large as a vehicle
    new = np.flatnonzero(~same.any(axis=1))
    pairs = same & (same.sum(axis=1, keepdims=True) == 1) & (same.sum(axis=0) == 1)
    instead, replaced = np.nonzero(pairs)
    kept = np.setdiff1d(np.arange(len(known.boxes)), replaced)
    looked_at = partial(_looked_at, world, refiner, still, frame, image)
    options = world.options.detect
    of_new = Found(
        boxes[new], np.full(len(new), options.min_score), np.full(len(new), RoadUserClass.CAR.number, dtype=np.int64)
    )
    of_pairs = Found(boxes[instead], known.scores[replaced], known.classes[replaced])
    parts = [
        known.where(kept),
        looked_at(of_pairs, classify=options.detector == "bundled"),  # other detectors know more than simulation
        looked_at(of_new, classify=True),
        detected.where(on_scenery),
    ]
    joined = _joined(parts)
    # scenery gives way to all that passes in front of it
    order = joined.scores - np.repeat([0.0, 0.0, 0.0, 1.0], [len(part.boxes) for part in parts])
    return joined.where(non_maximum_suppression(joined.boxes, order, options.nms_iou)), on_scenery


def _looked_at(
    world: World, refiner: EdgeRefiner, still: Still, frame: FrameKey, image: Image, found: Found, classify: bool
) -> Boxes2D:
    """What was found in a frame, px of the recording, with sharper edges, and with the refiner's classes, too."""
    store, camera_id = world.store, frame.camera_id
    stored = found._replace(boxes=store.to_stored_px(camera_id, found.boxes))
    nms_iou = world.options.detect.nms_iou
    seen = refiner.refine(image, still.background, stored, nms_iou=nms_iou, classify=classify)
    scale = scale_of(store.size(camera_id), store.native_size(camera_id), 4)
    native, amodal = (store.to_native_px(camera_id, edges) for edges in (seen.boxes, seen.amodal_boxes))
    return Boxes2D(native, seen.scores, seen.classes, amodal, seen.amodal_sd * scale)


def _joined(parts: Sequence[Boxes2D]) -> Boxes2D:
    boxes, scores, classes, amodal, amodal_sd = zip(*parts, strict=True)
    return Boxes2D(*map(np.concatenate, (boxes, scores, classes, amodal, amodal_sd)))


def _same(boxes: FloatArray, known: FloatArray) -> NDArray[np.bool_]:
    """(N, M) whether silhouettes (N, 4) and boxes (M, 4) show the same, or one of them a part of the other."""
    shared = intersections_px2(boxes, known)
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = np.maximum(shared / areas_px2(known), shared / areas_px2(boxes)[:, None])
    return np.asarray((image_iou(boxes, known) > SAME_IOU) | (np.nan_to_num(inside) > _SAME_INSIDE))


def _as_large_as_vehicles(camera: Camera, boxes: FloatArray) -> NDArray[np.bool_]:
    """(N,) whether boxes (N, 4) are as large as vehicles that stand where the middle of their lower edge is."""
    foot = np.column_stack([boxes[:, [0, 2]].mean(axis=1), boxes[:, 3]])
    places = intersect_plane(camera, foot)
    least, most = (
        np.array([_outline_px2(camera, places, size, yaw) for yaw in _YAWS]) for size in (_SMALLEST, _LARGEST)
    )
    area = areas_px2(boxes)
    # not so where it stands nowhere in view: NaN
    return np.asarray((area >= _LEAST_SHOWN * least.min(axis=0)) & (area <= most.max(axis=0)), dtype=bool)


def _outline_px2(camera: Camera, places: FloatArray, size_m: tuple[float, float, float], yaw: float) -> FloatArray:
    """(N,) areas of the outlines of vehicles of a size that stand at places (N, 3); NaN where they are not in view."""
    known = np.asarray(np.isfinite(places).all(axis=1))
    vehicles = np.empty((len(places), 7))
    vehicles[:, :2] = np.where(known[:, None], places[:, :2], 0.0)
    vehicles[:, 2], vehicles[:, 3:6], vehicles[:, 6] = size_m[2] / 2, size_m, yaw
    seen = outlines(camera, vehicles, BODIES[np.full(len(places), RoadUserClass.CAR.number)])
    return np.where(known & seen.in_image, areas_px2(seen.shown), np.nan)
