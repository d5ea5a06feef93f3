from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.builders import corner_rig, look_at
from wibam_core.association.rays import ground_covariances, ground_points, rig_centre, within_range
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import project_boxes
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import Detections2D


def detections(boxes: np.ndarray, vehicle_class: RoadUserClass = RoadUserClass.CAR) -> Detections2D:
    n = len(boxes)
    return Detections2D("cam1", 0, boxes, np.ones(n), np.full(n, vehicle_class.number))


def placed(camera: Camera, seen: Detections2D) -> np.ndarray:
    return ground_points(camera, seen.whole_boxes, seen.classes)


@pytest.mark.parametrize("height_m", [5.0, 8.0, 14.0])
@pytest.mark.parametrize("yaw", [0.0, 0.7, np.pi / 2])
def test_the_middle_of_a_car_is_found_from_any_height_and_side(height_m: float, yaw: float) -> None:
    camera = look_at((0.0, -25.0, height_m), focal_px=600)
    cars = np.array([[x, y, 0.67, 4.3, 1.8, 1.34, yaw] for x in (-6.0, 0.0, 6.0) for y in (-5.0, 5.0, 15.0)])
    points = placed(camera, detections(project_boxes(camera, cars)))
    assert np.abs(points - cars[:, :2]).max() < 0.6


def test_opposite_cameras_agree() -> None:
    rig = corner_rig()
    car = np.array([[3.0, -2.0, 0.67, 4.3, 1.8, 1.34, 0.4]])
    points = np.concatenate([placed(c, detections(project_boxes(c, car))) for c in rig.values()])
    assert np.ptp(points, axis=0).max() < 0.8


def test_what_something_hides_is_placed_by_its_amodal_box() -> None:
    camera = look_at((0.0, -25.0, 8.0), focal_px=600)
    car = np.array([[2.0, 3.0, 0.67, 4.3, 1.8, 1.34, 0.3]])
    whole = project_boxes(camera, car)
    half = whole.copy()
    half[:, 2] = whole[:, ::2].mean(axis=1)
    plain, seen = detections(half), replace(detections(half), amodal_boxes=whole, amodal_sd=np.ones((1, 4)))
    assert np.linalg.norm(placed(camera, plain) - car[:, :2]) > 0.9
    assert np.linalg.norm(placed(camera, seen) - car[:, :2]) < 0.3


def test_boxes_above_the_horizon_have_no_ground_point() -> None:
    camera = look_at((0.0, -25.0, 8.0), (0.0, 0.0, 8.0))
    assert np.isnan(placed(camera, detections(np.array([[300.0, 10, 320, 30]])))).all()


def test_every_class_has_a_plane_below_its_roof() -> None:
    for traits in (c.traits for c in CLASSES):
        assert 0.4 * traits.size.size_m[2] < traits.plane_height_m < 0.5 * traits.size.size_m[2]


def test_range_is_counted_from_between_the_cameras() -> None:
    centre = rig_centre(corner_rig())
    assert centre == pytest.approx([0, 0], abs=1e-9)
    points = np.array([[3.0, 4.0], [30.0, 41.0], [np.nan, 0.0]])
    assert within_range(points, centre, 50.0).tolist() == [True, False, False]


def test_flat_rays_are_uncertain_along_themselves() -> None:
    camera = look_at((0.0, -25.0, 8.0), focal_px=600)
    cars = np.array([[0.0, y, 0.67, 4.3, 1.8, 1.34, 0.0] for y in (-5.0, 25.0, 60.0)])
    seen = detections(project_boxes(camera, cars))
    points = placed(camera, seen)
    covariances = ground_covariances(camera, seen.whole_boxes, seen.classes, points)
    along, across = np.sqrt(covariances[:, 1, 1]), np.sqrt(covariances[:, 0, 0])
    assert (np.diff(along) > 0).all()
    assert along[2] > 2.0
    assert across == pytest.approx(0.5, abs=0.05)
    shifted = detections(seen.boxes + [0, 2, 0, 2])
    moved = np.linalg.norm(placed(camera, shifted) - points, axis=1)
    assert (moved < 2.5 * along).all()
