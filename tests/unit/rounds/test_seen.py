"""What a network sees as 2D boxes, and what of a detector stays beside it."""

import numpy as np

from tests.builders import look_at
from wibam_core.detection.boxes import Found
from wibam_core.geometry.box3d import corners
from wibam_core.road_users import RoadUserClass
from wibam_core.rounds.seen import beside, outlines_of
from wibam_core.scene import Boxes2D, Vehicles3D

CAR, PEDESTRIAN = RoadUserClass.CAR.number, RoadUserClass.PEDESTRIAN.number
CAMERA = look_at((0.0, -20.0, 6.0), focal_px=500.0, width_px=640, height_px=360)
BOX = np.array([0.0, 0.0, 0.75, 4.4, 1.8, 1.5, 0.3])


def found(boxes: list[list[float]], scores: list[float], classes: list[int]) -> Found:
    return Found(np.array(boxes, dtype=float).reshape(-1, 4), np.array(scores), np.array(classes, dtype=np.int64))


def detected(of: Found) -> Boxes2D:
    unknown = np.full((len(of.boxes), 4), np.nan)
    return Boxes2D(*of, unknown, unknown)


def test_the_outline_of_a_vehicle_is_a_little_smaller_than_its_cuboid() -> None:
    seen = outlines_of(Vehicles3D.of(0, BOX[None], scores=np.array([0.7])), CAMERA, 0.6)
    pixels, _ = CAMERA.project(corners(BOX[None]))
    cuboid = np.concatenate([pixels[0].min(axis=0), pixels[0].max(axis=0)])
    assert (seen.boxes[0, :2] >= cuboid[:2] - 0.1).all() and (seen.boxes[0, 2:] <= cuboid[2:] + 0.1).all()
    assert (np.abs(seen.boxes[0] - cuboid) < 0.15 * (cuboid[2:] - cuboid[:2]).max()).all()
    assert seen.scores.tolist() == [0.7]


def test_vehicles_behind_the_camera_or_out_of_view_have_no_outline_and_doubles_count_once() -> None:
    behind, beside_view, double = BOX.copy(), BOX.copy(), BOX.copy()
    behind[1], beside_view[0], double[0] = -40.0, 200.0, 0.2
    boxes = np.array([behind, beside_view, BOX, double])
    seen = outlines_of(Vehicles3D.of(0, boxes, scores=np.array([0.9, 0.9, 0.5, 0.8])), CAMERA, 0.6)
    assert seen.scores.tolist() == [0.8]


def test_boxes_of_the_detector_stay_where_the_network_has_none() -> None:
    network = found([[10, 10, 50, 40]], [0.6], [CAR])
    detector = found([[12, 11, 52, 41], [200, 50, 240, 80]], [0.9, 0.4], [CAR, CAR])
    both = beside(network, detected(detector))
    assert both.boxes.tolist() == [[10, 10, 50, 40], [200, 50, 240, 80]]
    assert both.scores.tolist() == [0.6, 0.4]


def test_a_vehicle_does_not_stand_for_a_person_before_it() -> None:
    both = beside(found([[10, 10, 50, 40]], [0.6], [CAR]), detected(found([[10, 10, 50, 40]], [0.9], [PEDESTRIAN])))
    assert both.classes.tolist() == [CAR, PEDESTRIAN]
