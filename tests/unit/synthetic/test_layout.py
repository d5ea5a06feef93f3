"""Intersections: different by seed, nothing stands on the road, routes are smooth."""

from __future__ import annotations

import numpy as np
import pytest

from wibam_core.synthetic.cameras import heads_in_view, look, site_cameras
from wibam_core.synthetic.layout import PHASES, make_layout, road_distance_m
from wibam_core.synthetic.routes import footprints_overlap, make_routes

SEEDS = range(8)


def test_the_same_seed_gives_the_same_layout_and_others_differ() -> None:
    one, again, other = make_layout(5), make_layout(5), make_layout(6)
    assert one.arms == again.arms
    assert one.poles == again.poles
    assert one.arms != other.arms


def test_some_layouts_have_three_arms() -> None:
    assert {len(make_layout(seed).arms) for seed in range(20)} == {3, 4}


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_stands_on_the_road(seed: int) -> None:
    layout = make_layout(seed)
    for thing in (*layout.poles, *layout.trees):
        place = np.array([thing.x_m, thing.y_m])
        for arm in layout.arms:
            if np.dot(place, arm.axis) > arm.kerb_m:
                assert not arm.out_edge_m < np.dot(place, arm.normal) < arm.in_edge_m
    for building in layout.buildings:
        assert road_distance_m(layout.arms, building.footprint).min() > 2.0


@pytest.mark.parametrize("seed", SEEDS)
def test_routes_are_smooth_and_end_on_their_lanes(seed: int) -> None:
    layout = make_layout(seed)
    routes = make_routes(layout)
    assert {r.movement for r in routes} <= {"left", "straight", "right"}
    for route in routes:
        s = np.arange(0, route.length_m, 0.5)
        yaw = np.unwrap(route.poses(s, 4.5)[:, 2])
        assert np.abs(np.diff(yaw)).max() < 0.25
        turn = yaw[-1] - yaw[0]
        expected = {"left": np.pi / 2, "straight": 0.0, "right": -np.pi / 2}[route.movement]
        assert turn == pytest.approx(expected, abs=0.45)
        end = route.position(route.length_m)
        lane = route.outgoing.lane_lateral_m(route.exit_lane, False)
        assert np.dot(end, route.outgoing.normal) == pytest.approx(lane, abs=1e-6)


def test_convention_traffic_keeps_to_the_right() -> None:
    for route in make_routes(make_layout(0)):
        x, y, yaw = route.poses(5.0, 4.5)
        to_centre_line = -np.dot([x, y], route.incoming.normal) * route.incoming.normal
        left = np.array([-np.sin(yaw), np.cos(yaw)])
        assert np.dot(left, to_centre_line) > 0


def test_convention_look_positive_pitch_looks_up() -> None:
    pose = look(np.array([1.0, 2.0, 3.0]), np.deg2rad(90), np.deg2rad(30))
    assert pose.rotate(np.array([0, 0, 1.0])) == pytest.approx([0, np.cos(np.pi / 6), 0.5])
    assert pose.rotate(np.array([1.0, 0, 0])) == pytest.approx([1, 0, 0])  # right of somebody who looks along +Y


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("count", [2, 4, 8])
def test_site_cameras_see_the_middle(seed: int, count: int) -> None:
    layout = make_layout(seed)
    cameras = site_cameras(layout, np.random.default_rng(seed), count, (640, 360))
    assert len(cameras) == count
    for camera in cameras:
        uv, depth = camera.project(np.array([0.0, 0.0, 0.5]))
        assert depth > 0
        assert camera.contains(uv)
        assert 5.0 <= camera.centre_m[2] <= 10.0


@pytest.mark.parametrize("seed", SEEDS)
def test_site_cameras_share_a_phase(seed: int) -> None:
    layout = make_layout(seed)
    cameras = site_cameras(layout, np.random.default_rng(seed), 4, (640, 360))
    seen = [
        {layout.signals[i].phase for i in np.flatnonzero(heads_in_view(camera, layout.signals))} for camera in cameras
    ]
    assert any(all(phase in phases for phases in seen) for phase in PHASES)


def test_site_camera_count_is_checked() -> None:
    with pytest.raises(ValueError, match="2 to 8"):
        site_cameras(make_layout(0), np.random.default_rng(0), 9, (640, 360))


def test_footprints_overlap_knows_rotation() -> None:
    a = np.array([0, 0, 0, 4.0, 2.0, 1.5, 0.0])
    beside = np.array([0, 2.1, 0, 4.0, 2.0, 1.5, 0.0])
    turned = np.array([0, 2.1, 0, 4.0, 2.0, 1.5, np.pi / 4])
    assert not footprints_overlap(a, beside)
    assert footprints_overlap(a, turned)
    assert footprints_overlap(a, a)
