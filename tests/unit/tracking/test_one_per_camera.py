"""3D boxes of two views of one wide lens are one measurement."""

from __future__ import annotations

import numpy as np

from tests.builders import look_at
from wibam_core.calibration.views import cut_view
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import CameraRig, Vehicles3D
from wibam_core.site import ViewDirection
from wibam_core.tracking.one_per_camera import found_once

K = np.array([[322.0, 0, 639.5], [0, 322.0, 479.5], [0, 0, 1]])
CAMERA = Camera(K, np.zeros(0), SE3(np.diag([1.0, -1, -1]), np.array([0.0, 0, 10])), 1280, 960, "fisheye")
VIEWS = tuple(
    cut_view(CAMERA, ViewDirection(azimuth_deg=azimuth), f"pole.{number}")
    for number, azimuth in enumerate((35.0, -35.0), 1)
)
RIG = CameraRig({"pole": CAMERA, "other": look_at((30.0, 0.0, 8.0))}, {"pole": VIEWS})


def found(camera_id: str, *places: tuple[float, float]) -> Vehicles3D:
    return Vehicles3D.of(0, np.array([[x, y, 0.8, 4.5, 1.8, 1.6, 0.0] for x, y in places]), camera_id=camera_id)


def test_a_box_of_two_views_stays_in_the_one_that_sees_it_nearer_to_its_middle() -> None:
    views = [found("pole.1", (18, 2), (5, 14)), found("pole.2", (18.4, 2.3), (18, -4)), found("other", (18.2, 2.1))]
    first, second, other = found_once(views, RIG, 2.0)
    np.testing.assert_array_equal(first.boxes[:, :2], [[18, 2], [5, 14]])
    np.testing.assert_array_equal(second.boxes[:, :2], [[18, -4]])
    assert len(other) == 1
    assert [vehicles.camera_id for vehicles in (first, second, other)] == ["pole.1", "pole.2", "other"]


def test_boxes_farther_apart_are_two_vehicles() -> None:
    apart = [found("pole.1", (18, 2)), found("pole.2", (18, -1.5))]
    assert [len(vehicles) for vehicles in found_once(apart, RIG, 2.0)] == [1, 1]
