"""What two views of one wide lens show is one detection."""

from __future__ import annotations

import numpy as np

from wibam_core.calibration.views import cut_view
from wibam_core.detection.one_per_camera import seen_once
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import project_boxes
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import Boxes2D, CameraRig, FrameKey
from wibam_core.site import ViewDirection

K = np.array([[322.0, 0, 639.5], [0, 322.0, 479.5], [0, 0, 1]])
CAMERA = Camera(K, np.zeros(0), SE3(np.diag([1.0, -1, -1]), np.array([0.0, 0, 10])), 1280, 960, "fisheye")
#: Two views 70 degrees apart and 90 wide, so that both show a sector of 20 degrees about the X axis.
VIEWS = tuple(
    cut_view(CAMERA, ViewDirection(azimuth_deg=azimuth, down_deg=38, height_deg=74), f"pole.{number}")
    for number, azimuth in enumerate((35.0, -35.0), 1)
)
RIG = CameraRig({"pole": CAMERA}, {"pole": VIEWS})
TIME_NS = 5


def detections(boxes: np.ndarray) -> Boxes2D:
    unknown = np.full((len(boxes), 4), np.nan)
    return Boxes2D(boxes, np.linspace(0.9, 0.5, len(boxes)), np.zeros(len(boxes), np.int64), unknown, unknown)


def seen(vehicles: np.ndarray) -> dict[FrameKey, Boxes2D]:
    """Every vehicle's box in both views, where it is in them; with how many there are of each."""
    found = {}
    for view in VIEWS:
        boxes = project_boxes(RIG[view.id], vehicles)
        found[FrameKey(view.id, TIME_NS)] = detections(boxes[np.isfinite(boxes).all(axis=1)])
    return found


def counts(found: dict[FrameKey, Boxes2D]) -> list[int]:
    return [len(found[FrameKey(view.id, TIME_NS)].boxes) for view in VIEWS]


def car(x: float, y: float, yaw: float = 0.3, length: float = 4.5) -> list[float]:
    return [x, y, 0.8, length, 1.8, 1.6, yaw]


def test_a_vehicle_in_both_views_counts_once_where_it_is_whole_or_nearer_to_the_middle() -> None:
    left = seen(np.array([car(18, 2.0)]))
    assert counts(left) == [1, 1]
    assert counts(seen_once(left, RIG)) == [1, 0]
    assert counts(seen_once(seen(np.array([car(18, -2.0)])), RIG)) == [0, 1]
    # at the edge of the first view it is cut there, and whole in the other
    edge = seen(np.array([car(12.0, -2.6, 1.5)]))
    assert counts(edge) == [1, 1]
    assert counts(seen_once(edge, RIG)) == [0, 1]
    # a long one that both cut stays once
    long = seen(np.array([car(9.0, 0.1, np.pi / 2, 12.0)]))
    assert counts(long) == [1, 1]
    assert sum(counts(seen_once(long, RIG))) == 1


def test_different_vehicles_all_stay_and_doing_it_twice_changes_nothing() -> None:
    vehicles = np.array([car(18, 2.0), car(18, -2.5), car(27, 0.5), car(5, 14, 1.0), car(6, -15, 2.0)])
    once = seen_once(seen(vehicles), RIG)
    assert sum(counts(once)) == len(vehicles)
    twice = seen_once(once, RIG)
    for frame, boxes in once.items():
        for one, again in zip(boxes, twice[frame], strict=True):
            np.testing.assert_array_equal(one, again)


def test_views_of_other_moments_and_cameras_with_a_pinhole_are_left_alone() -> None:
    both = seen(np.array([car(18, 2.0)]))
    first, second = both.values()
    apart = {FrameKey("pole.1", 1): first, FrameKey("pole.2", 2): second}
    assert [len(boxes.boxes) for boxes in seen_once(apart, RIG).values()] == [1, 1]
    assert seen_once({FrameKey("pole.1", 1): detections(np.zeros((0, 4)))}, RIG)[FrameKey("pole.1", 1)].boxes.size == 0
