"""What moves, beside what a detector found."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.builders import corner_rig
from wibam_core.config import AssociateConfig, DatasetConfig, DetectConfig, LiftConfig, RoundsConfig
from wibam_core.detection.instants import frames_of
from wibam_core.detection.second_look import backgrounds_shown
from wibam_core.formats.framestore import FrameStore, FrameStoreWriter
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.road_users import RoadUserClass
from wibam_core.rounds.moving import beside_what_moves, looked_at_again
from wibam_core.rounds.world import Options, World
from wibam_core.scene import Boxes2D, CameraRig, FrameKey

CAMERA = "cam1"
NOTHING = Boxes2D(np.empty((0, 4)), np.empty(0), np.empty(0, dtype=np.int64), np.empty((0, 4)), np.empty((0, 4)))
INSTANTS = 24


def corners(x_m: float, size_m: tuple[float, float, float]) -> np.ndarray:
    """(8, 3) of a block that stands on the ground at (x, 0), along X."""
    signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [0.0, 1.0])).reshape(3, 8).T
    return np.array([x_m, 0.0, 0.0]) + signs * size_m


def place_m(number: int) -> float:
    """It drives through the view."""
    return -23.0 + 2.0 * number


def queueing_m(number: int) -> float:
    """It stands in the middle for most of the time, and then drives off."""
    return max(0.0, 3.0 * (number - 15))


def recorded(
    folder: Path, size_m: tuple[float, float, float], way: Callable[[int], float] = place_m
) -> tuple[World, dict[FrameKey, np.ndarray]]:
    """A block of a size drives before one camera; where it is seen, px of the recording."""
    rig = CameraRig({CAMERA: corner_rig()[CAMERA]})
    camera = rig[CAMERA]
    rng = np.random.default_rng(0)
    still = np.full((camera.height_px, camera.width_px, 3), (96, 100, 104), np.uint8)
    boxes = {}
    with FrameStoreWriter(folder, 95) as writer:
        for number in range(INSTANTS):
            time_ns = number * 200_000_000
            pixels, _ = camera.project(corners(way(number), size_m))
            image = np.clip(still + rng.normal(0.0, 2.0, still.shape), 0, 255).astype(np.uint8)
            seen = bool(camera.contains(pixels).all())
            if seen:
                cv2.fillConvexPoly(image, cv2.convexHull(pixels.round().astype(np.int32)), (40, 30, 120))
            small = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            writer.add(CAMERA, time_ns, time_ns, small)
            box = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])[None]
            boxes[FrameKey(CAMERA, time_ns)] = box if seen else np.empty((0, 4))
        writer.close({CAMERA: (camera.width_px, camera.height_px)})
    store = FrameStore(folder)
    shown = backgrounds_shown(store, {CAMERA: store.stored_ns(CAMERA)}, 120.0, None)
    options = Options(RoundsConfig(), DetectConfig(), AssociateConfig(), DatasetConfig(), LiftConfig())
    return World(rig, {}, store, store.frame_sets, shown, Path(), options, folder), boxes


def test_a_vehicle_that_no_detector_found_is_found(tmp_path: Path) -> None:
    world, boxes = recorded(tmp_path, (4.4, 1.8, 1.5))
    frames = frames_of(world.instants)
    found = beside_what_moves(world, dict.fromkeys(frames, NOTHING)).found
    assert list(found) == frames
    there = [frame for frame in frames if len(boxes[frame])]
    overlaps = [image_iou(found[frame].boxes, boxes[frame]).max(initial=0.0) for frame in there]
    assert len(there) > INSTANTS / 2 and np.mean(np.array(overlaps) > 0.6) > 0.9
    assert sum(len(of.boxes) for of in found.values()) <= 1.1 * len(there)
    assert all(np.isfinite(of.amodal_boxes).all() for of in found.values())
    assert {score for of in found.values() for score in of.scores} == {world.options.detect.min_score}


def test_one_that_stood_for_most_of_the_time_is_found_while_it_stood_and_no_ghost_is_left(tmp_path: Path) -> None:
    world, boxes = recorded(tmp_path, (4.4, 1.8, 1.5), queueing_m)
    frames = frames_of(world.instants)
    found = beside_what_moves(world, dict.fromkeys(frames, NOTHING)).found
    overlaps = [image_iou(found[f].boxes, boxes[f]).max(initial=0.0) for f in frames if len(boxes[f])]
    assert len(overlaps) > 16 and np.mean(np.array(overlaps) > 0.6) > 0.9
    gone = [frame for frame in frames if not len(boxes[frame])]
    assert gone and not any(len(found[frame].boxes) for frame in gone)


@pytest.mark.parametrize("size_m", [(0.5, 0.5, 0.6), (12.0, 12.0, 9.0)], ids=["dog", "house"])
def test_what_is_no_vehicle_by_its_size_is_not(tmp_path: Path, size_m: tuple[float, float, float]) -> None:
    world, _ = recorded(tmp_path, size_m)
    found = beside_what_moves(world, dict.fromkeys(frames_of(world.instants), NOTHING)).found
    assert sum(len(of.boxes) for of in found.values()) <= 2


def test_a_silhouette_takes_the_place_of_the_one_box_in_it(tmp_path: Path) -> None:
    world, boxes = recorded(tmp_path, (4.4, 1.8, 1.5))
    half = np.array([1.0, 1.0, 0.5, 1.0])  # its left half alone
    known = {
        frame: Boxes2D(
            box * half + np.roll(box, 2, axis=1) * [0, 0, 0.5, 0],
            np.full(len(box), 0.7),
            np.full(len(box), 1),
            box,
            box,
        )
        for frame, box in boxes.items()
    }
    found = beside_what_moves(world, known).found
    there = [frame for frame in found if len(boxes[frame])]
    assert all(len(found[frame].boxes) == 1 and found[frame].scores[0] == 0.7 for frame in there)
    overlaps = [image_iou(found[frame].boxes, boxes[frame]).max() for frame in there]
    assert np.mean(np.array(overlaps) > 0.6) > 0.9


def test_nobody_on_foot_becomes_a_vehicle(tmp_path: Path) -> None:
    world, boxes = recorded(tmp_path, (4.4, 1.8, 1.5))
    foot, known = RoadUserClass.PEDESTRIAN.number, {}
    for frame, box in boxes.items():
        left_fifth = box * [1.0, 1.0, 0.2, 1.0] + np.roll(box, 2, axis=1) * [0.0, 0.0, 0.8, 0.0]
        unknown = np.full_like(box, np.nan)
        known[frame] = Boxes2D(left_fifth, np.full(len(box), 0.7), np.full(len(box), foot), unknown, unknown)
    found = beside_what_moves(world, known).found
    for frame, of in known.items():
        np.testing.assert_array_equal(found[frame].boxes[found[frame].classes == foot], of.boxes)


def test_the_boxes_of_several_vehicles_in_a_row_stay(tmp_path: Path) -> None:
    world, boxes = recorded(tmp_path, (9.0, 2.0, 2.0))
    known = {}
    for frame, box in boxes.items():
        x0, y0, x1, y1 = box.T
        middle = (x0 + x1) / 2
        halves = np.concatenate([np.stack([x0, y0, middle, y1], 1), np.stack([middle, y0, x1, y1], 1)])
        known[frame] = Boxes2D(halves, np.full(len(halves), 0.7), np.full(len(halves), 1), halves, halves)
    found = beside_what_moves(world, known).found
    for frame, of in found.items():
        np.testing.assert_array_equal(np.sort(of.boxes, axis=0), np.sort(known[frame].boxes, axis=0))


def test_boxes_on_what_never_changes_are_told_apart_and_hide_nothing_that_passes(tmp_path: Path) -> None:
    """In every frame a detector has a box beside the road, one on it, and one around all of the view."""
    world, boxes = recorded(tmp_path, (4.4, 1.8, 1.5))
    there = [frame for frame in boxes if len(boxes[frame])]
    on_road = boxes[there[len(there) // 2]][0]
    always = np.array([[20.0, 20.0, 90.0, 60.0], on_road, [0.0, 0.0, 639.0, 359.0]])
    known = {f: Boxes2D(always, np.full(3, 0.9), np.ones(3, np.int64), always, always) for f in boxes}
    _, told_apart, _ = beside_what_moves(world, known)
    for frame in boxes:
        np.testing.assert_array_equal(told_apart.on_scenery[frame].boxes, always[[0, 2]])
        np.testing.assert_array_equal(told_apart.trusted[frame].boxes, always[[1]])  # somebody has been there
    # without the box on the road, which may be who stood there, nothing hides who passes
    scenery = {f: of.where(np.array([0, 2])) for f, of in known.items()}
    found = beside_what_moves(world, scenery).found
    overlaps = [image_iou(found[frame].boxes, boxes[frame]).max(initial=0.0) for frame in there]
    assert np.mean(np.array(overlaps) > 0.6) > 0.9


def test_stills_are_held_for_networks_alone_and_without_what_a_look_computes(tmp_path: Path) -> None:
    world, _ = recorded(tmp_path, (4.4, 1.8, 1.5))
    frames = frames_of(world.instants)
    found, _, stills = beside_what_moves(world, dict.fromkeys(frames, NOTHING))
    again, on_scenery = looked_at_again(world, stills, found)
    assert list(again) == list(on_scenery) == frames
    assert any(np.isfinite(of.amodal_boxes).any() for of in again.values())
    assert stills and not any("layers" in vars(still.background) for still in stills.values())
    without = replace(world, options=replace(world.options, rounds=RoundsConfig(most=0)))
    assert not beside_what_moves(without, dict.fromkeys(frames, NOTHING)).stills
