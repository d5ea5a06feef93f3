"""Vehicles without a 2D box of their own: which are surely seen, and which are not judged."""

import numpy as np

from tests.builders import look_at
from tests.labelled_views import tight_boxes
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.training.overlooked import Overlooked, overlooked

#: 20 m from the origin, which it looks at.
CAMERA = look_at((20.0, 0.0, 7.0))
NOTHING = np.zeros((0, 4))
CAR = [0.0, 0.0, 0.75, 4.4, 1.8, 1.5, 0.4]
#: To the left of the image's left border, by most or by a part of its length.
LEFT, CUT = ([7.0, y, 0.75, 4.4, 1.8, 1.5, 1.5708] for y in (-11.3, -9.3))


def seen(*vehicles: list[float], found: tuple[int, ...] = (), boxes: np.ndarray = NOTHING) -> Overlooked:
    is_found = np.isin(np.arange(len(vehicles)), found)
    return overlooked(CAMERA, np.array(vehicles).reshape(-1, 7), np.zeros(len(vehicles), np.int64), is_found, boxes)


def cuboid_box(vehicle: list[float]) -> np.ndarray:
    """(1, 4) within the image; that of the body is a little smaller."""
    return np.clip(tight_boxes(np.array([vehicle]), CAMERA), -0.5, np.array([639.5, 359.5] * 2))


def test_a_vehicle_without_a_box_is_seen_where_it_is() -> None:
    result = seen(CAR)
    assert result.rows.tolist() == [0] and len(result.unsure) == 0
    assert image_iou(result.boxes2d, cuboid_box(CAR))[0, 0] > 0.7


def test_nothing_is_overlooked_where_the_vehicle_has_a_box_or_there_is_one_that_may_be_its_own() -> None:
    for result in (seen(CAR, found=(0,)), seen(CAR, boxes=cuboid_box(CAR) + 5.0), seen()):
        assert len(result.rows) == len(result.boxes2d) == len(result.unsure) == 0
    assert seen(CAR, boxes=cuboid_box(CAR) + 80.0).rows.tolist() == [0]


def test_the_box_of_a_vehicle_that_the_border_cuts_ends_there() -> None:
    result = seen(CAR, CUT)
    assert result.rows.tolist() == [0, 1]
    assert result.boxes2d[1, 0] == -0.5 < 20 < result.boxes2d[1, 2]
    assert image_iou(result.boxes2d[1:], cuboid_box(CUT))[0, 0] > 0.7


def test_a_vehicle_of_which_little_is_in_the_image_is_not_judged() -> None:
    result = seen(CAR, LEFT)
    assert result.rows.tolist() == [0]
    assert len(result.unsure) == 1 and result.unsure[0, 0] == -0.5 and result.unsure[0, 2] > 0


def test_a_vehicle_behind_a_nearer_one_is_not_judged_whether_that_was_found_or_not() -> None:
    truck = [5.0, 0.0, 1.6, 7.0, 2.5, 3.2, 1.5708]  # across the view
    for found, rows in (((), [1]), ((1,), [])):
        result = seen(CAR, truck, found=found)
        assert result.rows.tolist() == rows
        assert len(result.unsure) == 1 and image_iou(result.unsure, cuboid_box(CAR))[0, 0] > 0.7
    behind = [-9.0, 0.0, 1.6, 7.0, 2.5, 3.2, 1.5708]
    assert seen(CAR, behind, found=(1,)).rows.tolist() == [0]


def test_vehicles_out_of_the_image_are_nothing() -> None:
    beside, behind_the_camera = [0.0, 60.0, *CAR[2:]], [30.0, 0.0, *CAR[2:]]
    about_the_camera = [20.0, 0.0, 1.6, 12.0, 2.5, 3.2, 0.0]
    far = [-600.0, 0.0, *CAR[2:]]
    result = seen(beside, behind_the_camera, about_the_camera, far)
    assert len(result.rows) == 0
    assert len(result.unsure) == 1  # the far one: too small
