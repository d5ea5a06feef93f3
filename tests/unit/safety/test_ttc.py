from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely import affinity
from shapely.geometry import Polygon

from wibam_core.geometry.box3d import footprints
from wibam_core.safety.ttc import contact_interval, footprints_touch, time_to_collision

REST = np.zeros(2)


def box(x: float, y: float, yaw: float = 0.0, length: float = 4.0, width: float = 2.0) -> np.ndarray:
    return np.array([x, y, 0.75, length, width, 1.5, yaw])


def test_a_follower_needs_the_gap_over_the_closing_speed() -> None:
    ttc = time_to_collision(box(0, 0), [10.0, 0.0], box(24, 0), [5.0, 0.0])
    assert ttc == pytest.approx((24 - 4) / 5)


def test_crossing_at_a_right_angle() -> None:
    # a's front is at x = 2, b's right side at x = 9; b's front passes a's lane (|y| < 1) from 0.8 s to 1.4 s.
    ttc = time_to_collision(box(0, 0), [10.0, 0.0], box(10, -11, np.pi / 2), [0.0, 10.0])
    assert ttc == pytest.approx(0.8)


def test_a_miss_is_never() -> None:
    assert time_to_collision(box(0, 0), [10.0, 0.0], box(30, 2.01), REST) == np.inf
    assert np.isfinite(time_to_collision(box(0, 0), [10.0, 0.0], box(30, 1.99), REST))


def test_zero_only_where_they_overlap() -> None:
    assert time_to_collision(box(0, 0), REST, box(3.9, 0), REST) == 0
    assert time_to_collision(box(0, 0), REST, box(4.01, 0), REST) == np.inf
    assert time_to_collision(box(0, 0), [1.0, 0.0], box(4.01, 0), REST) == pytest.approx(0.01)


def test_a_contact_in_the_past_does_not_count() -> None:
    assert time_to_collision(box(0, 0), [-5.0, 0.0], box(10, 0), REST) == np.inf
    first, last = contact_interval(box(0, 0), [-5.0, 0.0], box(10, 0), REST)
    assert first < last < 0


def test_shapes_broadcast() -> None:
    a = np.stack([box(0, 0), box(0, 50)])[:, None]
    b = np.stack([box(10, 0), box(10, 50), box(10, 99)])
    out = time_to_collision(a, np.array([5.0, 0]), b, REST)
    assert out.shape == (2, 3)
    np.testing.assert_array_equal(np.isfinite(out), [[True, False, False], [False, True, False]])


coordinate = st.floats(-20, 20)
angle = st.floats(-3.1, 3.1)
size = st.floats(0.5, 12)
speed = st.integers(-150, 150).map(lambda v: v / 10)
state = st.tuples(coordinate, coordinate, angle, size, size, speed, speed)


def unpack(s: tuple) -> tuple[np.ndarray, np.ndarray]:
    return box(*s[:5]), np.array(s[5:])


def polygon(b: np.ndarray) -> Polygon:
    return Polygon(footprints(b))


@settings(max_examples=150)
@given(state, state)
def test_shapely_agrees_that_they_are_apart_until_the_contact_and_touch_at_it(p: tuple, q: tuple) -> None:
    (a, va), (b, vb) = unpack(p), unpack(q)
    ttc = float(time_to_collision(a, va, b, vb))
    moving = lambda t: affinity.translate(polygon(b), *((vb - va) * t)).distance(polygon(a))  # noqa: E731
    if ttc == 0:
        assert moving(0) <= 1e-9
    elif np.isfinite(ttc) and ttc < 1e3:
        assert moving(ttc) == pytest.approx(0, abs=1e-6)
        assert all(moving(share * ttc) > 0 for share in (0, 0.3, 0.6, 0.9))
    elif ttc == np.inf:
        assert all(moving(t) > 0 for t in (0.0, 1.0))
        assert min(moving(t) for t in np.linspace(0, 10, 50)) > 0 or np.allclose(va, vb)


@settings(max_examples=100)
@given(state, state)
def test_law_symmetric_in_the_pair(p: tuple, q: tuple) -> None:
    (a, va), (b, vb) = unpack(p), unpack(q)
    np.testing.assert_allclose(time_to_collision(a, va, b, vb), time_to_collision(b, vb, a, va), rtol=1e-9)


def grazes(a: np.ndarray, va: np.ndarray, b: np.ndarray, vb: np.ndarray) -> bool:
    """Whether rounding decides if they meet."""
    hair = np.array([0, 0, 0, 1e-6, 1e-6, 0, 0])
    return len({bool(contact_interval(a + h, va, b + h, vb)[0] == np.inf) for h in (-hair, 0 * hair, hair)}) > 1


@settings(max_examples=100)
@given(state, state, angle, coordinate, coordinate)
def test_law_invariant_under_rigid_motion_and_common_velocity(
    p: tuple, q: tuple, turn: float, x: float, y: float
) -> None:
    (a, va), (b, vb) = unpack(p), unpack(q)
    first, last = contact_interval(a, va, b, vb)
    assume(not grazes(a, va, b, vb))
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def moved(s: np.ndarray) -> np.ndarray:
        out = s.copy()
        out[:2] = R @ s[:2] + [x, y]
        out[6] += turn
        return out

    other = contact_interval(moved(a), R @ va + [3.0, 1.0], moved(b), R @ vb + [3.0, 1.0])
    np.testing.assert_allclose([first, last], other, rtol=1e-5, atol=1e-5)


def test_convention_yaw_not_velocity_gives_the_footprint() -> None:
    # a slides sideways: its long side meets b
    assert time_to_collision(box(0, 0, np.pi / 2), [10.0, 0.0], box(10, 0), REST) == pytest.approx(0.7)
    assert footprints_touch(box(0, 0), box(3, 1.5))


@pytest.mark.assets
def test_real_crossing_pair(assets: Path) -> None:
    with (assets / "conflicts" / "Case1_angle_conflict_raw_input.csv").open(newline="") as file:
        rows = np.array([[float(v) for v in row] for row in list(csv.reader(file))[1:]])
    a, b = (rows[rows[:, 7] == vehicle] for vehicle in (1, 2))

    def states(r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n = len(r)
        boxes = np.column_stack([r[:, 1:3], np.full(n, 0.75), r[:, 5:7], np.full(n, 1.5), r[:, 4]])
        return boxes, r[:, 3:4] * np.column_stack([np.cos(r[:, 4]), np.sin(r[:, 4])])

    ttc = time_to_collision(*states(a), *states(b))
    assert ttc.min() == pytest.approx(1.274, abs=0.01)
    assert a[ttc.argmin(), 0] == pytest.approx(3.54)
    assert np.hypot(*(a - b)[:, 1:3].T).min() == pytest.approx(7.008, abs=0.001)
