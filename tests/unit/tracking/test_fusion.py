from __future__ import annotations

import numpy as np
import pytest

from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Vehicles3D
from wibam_core.tracking.fusion import Detected, Fused
from wibam_core.tracking.fusion import fuse as fuse_detected


def seen(*rows: tuple[float, float, float], sd: float | None = None, scores: list[float] | None = None,
         cls: int = 0, length: float = 4.5) -> Vehicles3D:  # fmt: skip
    boxes = np.array([[x, y, 0.75, length, 1.8, 1.5, yaw] for x, y, yaw in rows]).reshape(-1, 7)
    n = len(boxes)
    return Vehicles3D.of(
        0, boxes, np.full(n, cls), scores=None if scores is None else np.array(scores),
        sd=None if sd is None else np.full((n, 7), sd),
    )  # fmt: skip


def fuse(detections: list[Vehicles3D], radius_m: float) -> Fused:
    return fuse_detected(Detected.of(detections), radius_m)


def test_views_of_one_vehicle_become_one_box() -> None:
    fused = fuse([seen((0, 0, 0.1)), seen((1, 0, 0.2)), seen((0.5, 0.3, 0.0))], 2.5)
    assert fused.views.tolist() == [3]
    assert fused.boxes[0, :2] == pytest.approx([0.5, 0.1])
    assert fused.boxes[0, 6] == pytest.approx(0.1, abs=1e-3)


def test_one_camera_never_gives_a_vehicle_twice() -> None:
    fused = fuse([seen((0, 0, 0), (1.0, 0, 0)), seen((0.4, 0, 0))], 2.5)
    assert sorted(fused.views.tolist()) == [1, 2]


def test_the_surer_view_has_more_say() -> None:
    fused = fuse([seen((0, 0, 0), sd=0.1), seen((1, 0, 0), sd=1.0)], 2.5)
    assert 0 < fused.boxes[0, 0] < 0.1
    assert fused.sd[0, 0] < 0.3


def test_opposite_headings_are_outvoted_by_score() -> None:
    fused = fuse(
        [seen((0, 0, 3.1), scores=[0.9]), seen((0, 0, -3.1), scores=[0.8]), seen((0, 0, 0.0), scores=[0.95])], 2.5
    )
    assert abs(normalise_angle(fused.boxes[0, 6] - np.pi)) < 0.05
    assert fused.headings[0].tolist() == pytest.approx([1.7, 0.95])


def test_neighbours_in_the_next_lane_stay_apart() -> None:
    fused = fuse([seen((0, 0, 0), (0, 3.5, 0)), seen((0.5, 0.4, 0), (0.5, 3.1, 0))], 2.5)
    assert fused.views.tolist() == [2, 2]


def test_who_does_not_know_a_place_well_may_be_further_off() -> None:
    """3 m are more than the radius, but no more than 2 of a far camera's standard deviations of 1.6 m."""
    near = seen((0, 0, 0), sd=0.2)
    assert fuse([near, seen((3.0, 0, 0), sd=1.6)], 2.5).views.tolist() == [2]
    assert fuse([near, seen((3.0, 0, 0), sd=1.0)], 2.5).views.tolist() == [1, 1]
    assert fuse([near, seen((4.0, 0, 0), sd=5.0)], 2.5).views.tolist() == [1, 1], "beyond 1.5 radii it is another one"


def test_chains_do_not_swallow_a_row_of_vehicles() -> None:
    fused = fuse([seen((0, 0, 0)), seen((2, 0, 0)), seen((4, 0, 0))], 2.5)
    assert len(fused) == 2


def test_long_vehicles_may_differ_more_along_their_heading() -> None:
    assert len(fuse([seen((0, 0, 0), length=12), seen((4, 0, 0), length=12)], 2.5)) == 1
    assert len(fuse([seen((0, 0, 0), length=12), seen((0, 4, 0), length=12)], 2.5)) == 2
    assert len(fuse([seen((0, 0, 0)), seen((4, 0, 0))], 2.5)) == 2
    assert len(fuse([seen((0, 0, 0)), seen((4, 0, 0))], 4.5)) == 1


def test_classes_vote_with_their_scores() -> None:
    fused = fuse([seen((0, 0, 0), scores=[0.5]), seen((0, 0, 0), scores=[0.9], cls=2)], 2.5)
    assert fused.votes[0].argmax() == RoadUserClass.TRUCK.number


def test_nothing_seen() -> None:
    assert len(fuse([], 2.5)) == 0
    assert len(fuse([seen(), seen()], 2.5)) == 0
