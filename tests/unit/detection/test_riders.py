"""Who is one road user with whom, on boxes as a detector with COCO's classes gives them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.detection.boxes import Found
from wibam_core.detection.detector import load_detector
from wibam_core.detection.riders import road_users
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.video.decode import decode

CAR, BICYCLE, MOTORCYCLE, PEDESTRIAN = (
    c.number for c in (RoadUserClass.CAR, RoadUserClass.BICYCLE, RoadUserClass.MOTORCYCLE, RoadUserClass.PEDESTRIAN)
)


def found(*boxes: tuple[float, float, float, float], kind: int, score: float = 0.8) -> Found:
    n = len(boxes)
    return Found(np.array(boxes, dtype=float).reshape(-1, 4), np.full(n, score), np.full(n, kind, dtype=np.int64))


def one_box_each(vehicles=(), two_wheelers=(), persons=(), kind=BICYCLE):
    return road_users(
        found(*vehicles, kind=CAR),
        found(*two_wheelers, kind=kind, score=0.5),
        found(*persons, kind=PEDESTRIAN),
        0.6,
    )


@pytest.mark.parametrize(
    ("bicycle", "person"),
    [
        ((100, 160, 175, 205), (120, 130, 155, 192)),  # from the side
        ((100, 150, 120, 205), (96, 120, 124, 195)),  # from behind
        ((100, 122, 124, 205), (97, 122, 125, 180)),  # boxed with its rider already
    ],
)
def test_a_rider_is_one_road_user_with_the_bicycle(bicycle, person) -> None:
    both = one_box_each(two_wheelers=[bicycle], persons=[person])
    assert both.classes.tolist() == [BICYCLE]
    assert both.boxes[0].tolist() == [*np.minimum(bicycle[:2], person[:2]), *np.maximum(bicycle[2:], person[2:])]
    assert both.scores.tolist() == [0.8]  # as sure as the surer of the two


def test_somebody_who_stands_before_or_beside_a_bicycle_walks() -> None:
    parked = (100, 160, 175, 205)
    for person in ((120, 140, 150, 225), (180, 130, 210, 205)):
        both = one_box_each(two_wheelers=[parked], persons=[person])
        assert sorted(both.classes.tolist()) == sorted([BICYCLE, PEDESTRIAN])
        assert both.boxes[both.classes == BICYCLE].tolist() == [list(parked)]


def test_two_riders_side_by_side_each_have_their_own() -> None:
    bicycles = [(100, 160, 130, 210), (125, 160, 155, 210)]
    persons = [(126, 130, 152, 196), (102, 130, 128, 196)]
    both = one_box_each(two_wheelers=bicycles, persons=persons)
    assert both.classes.tolist() == [BICYCLE, BICYCLE]
    assert sorted(both.boxes[:, 0].tolist()) == [100, 125]


def test_a_passenger_is_no_road_user_of_their_own() -> None:
    both = one_box_each(
        two_wheelers=[(100, 160, 170, 210)], persons=[(110, 130, 135, 195), (130, 132, 155, 195)], kind=MOTORCYCLE
    )
    assert both.classes.tolist() == [MOTORCYCLE]
    assert both.boxes[0].tolist() == [100, 130, 170, 210]


def test_a_two_wheeler_found_with_and_without_its_rider_is_one() -> None:
    both = one_box_each(two_wheelers=[(100, 130, 130, 200), (102, 165, 129, 208)], persons=[(101, 128, 129, 195)])
    assert len(both.classes) == 1


def test_people_in_a_car_do_not_walk_but_those_before_it_do() -> None:
    car = (100, 100, 220, 180)
    driver, before, behind = (150, 108, 175, 135), (140, 95, 165, 185), (60, 80, 80, 130)
    both = one_box_each(vehicles=[car], persons=[driver, before, behind])
    assert sorted(both.classes.tolist()) == [CAR, PEDESTRIAN, PEDESTRIAN]
    assert list(driver) not in both.boxes.tolist()


BOX = st.tuples(st.floats(0, 500), st.floats(0, 300), st.floats(2, 100), st.floats(2, 100)).map(
    lambda b: (b[0], b[1], b[0] + b[2], b[1] + b[3])
)


@given(st.lists(BOX, max_size=4), st.lists(BOX, max_size=4), st.lists(BOX, max_size=4))
def test_nobody_is_invented(vehicles, two_wheelers, persons) -> None:
    both = one_box_each(vehicles, two_wheelers, persons)
    counts = {kind: int((both.classes == kind).sum()) for kind in (CAR, BICYCLE, PEDESTRIAN)}
    assert counts[CAR] == len(vehicles)
    assert counts[BICYCLE] <= len(two_wheelers)
    assert counts[PEDESTRIAN] <= len(persons)
    assert (np.diff(both.scores) <= 0).all()


@pytest.mark.assets
def test_real_motorcyclists_at_a_junction(assets: Path) -> None:
    detector = load_detector(assets / "detectors" / "yolox_nano.onnx", min_score=0.3, nms_iou=0.6)
    frames = decode(assets / "signals" / "junction_640x480_6fps.mp4")
    frame = next(image for number, (_, image) in enumerate(frames) if number == 180)
    seen = detector.detect(frame)
    # read off the picture by eye: xyxy around four motorcycles with their riders, and two cars
    riders = np.array([[246, 259, 294, 328], [382, 252, 411, 315], [429, 241, 459, 304], [458, 323, 494, 403]])
    cars = np.array([[193, 333, 318, 453], [333, 348, 442, 470]])
    for boxes, kind in ((riders, MOTORCYCLE), (cars, CAR)):
        assert image_iou(boxes.astype(float), seen.boxes[seen.classes == kind]).max(axis=1).min() > 0.75
    walking = seen.boxes[seen.classes == PEDESTRIAN]
    assert image_iou(riders.astype(float), walking).max(initial=0.0) < 0.3
    assert {CLASSES[number] for number in seen.classes} <= set(detector.classes)
