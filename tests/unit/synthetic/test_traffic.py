"""Traffic obeys: nobody overlaps, nobody passes red, motion is smooth and repeatable."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from wibam_core.synthetic.driving import STEP_S
from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.routes import footprints_overlap
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.traffic import Traffic, simulate_traffic

SEEDS = (2, 3, 7)


@lru_cache
def traffic_of(seed: int) -> Traffic:
    return simulate_traffic(make_layout(seed), seed, 30.0, SignalProgram(22.0))


@pytest.mark.parametrize("seed", SEEDS)
def test_vehicles_do_not_overlap(seed: int) -> None:
    traffic = traffic_of(seed)
    for time_s in np.arange(0, 30, 0.25):
        _, boxes = traffic.at(float(time_s))
        i, j = np.triu_indices(len(boxes), 1)
        assert not footprints_overlap(boxes[i], boxes[j]).any(), time_s


@pytest.mark.parametrize("seed", SEEDS)
def test_nobody_passes_the_stop_line_at_red(seed: int) -> None:
    traffic = traffic_of(seed)
    crossings = 0
    for t in traffic.trajectories:
        if t.route is None:
            continue
        front = t.s_m + t.model.length_m / 2
        for k in np.flatnonzero((front[:-1] < t.route.stop_s_m) & (front[1:] >= t.route.stop_s_m)):
            crossings += 1
            assert traffic.program.state(t.route.incoming.phase, (t.first_step + int(k)) * STEP_S) != "red"
    assert crossings > 3


@pytest.mark.parametrize("seed", SEEDS)
def test_vehicles_stop_at_red_and_go_on_later(seed: int) -> None:
    traffic = traffic_of(seed)
    waits, left = 0, 0
    for t in traffic.trajectories:
        if t.route is None:
            continue
        gap = t.route.stop_s_m - t.s_m - t.model.length_m / 2
        waiting = (t.speed_mps < 0.1) & (gap > -0.3) & (gap < 2.0)
        waits += bool(waiting.sum() * STEP_S > 2.0)
        left += bool(t.s_m[-1] > t.route.box_s_m[1])
    assert waits >= 2
    assert left >= 3


@pytest.mark.parametrize("seed", SEEDS)
def test_motion_is_smooth(seed: int) -> None:
    for t in traffic_of(seed).trajectories:
        if t.route is None:
            continue
        assert (np.diff(t.s_m) >= -1e-9).all()
        assert np.abs(np.diff(t.speed_mps)).max() / STEP_S <= 7.0 + 1e-6
        assert t.speed_mps.max() < 20


def test_positions_between_steps_lie_between_them() -> None:
    t = next(t for t in traffic_of(3).trajectories if t.route is not None and t.speed_mps.max() > 5)
    k = int(np.argmax(t.speed_mps[:-1]))
    start = (t.first_step + k) * STEP_S
    boxes = [t.box(start + u * STEP_S) for u in (0.0, 0.25, 0.5, 0.75, 0.999999)]
    assert all(box is not None for box in boxes)
    steps = np.linalg.norm(np.diff(np.array(boxes)[:, :2], axis=0), axis=1)
    assert steps == pytest.approx(np.full(4, t.speed_mps[k] * STEP_S / 4), rel=0.1)


def test_vehicles_stand_on_the_ground_and_ids_differ() -> None:
    traffic = traffic_of(2)
    present, boxes = traffic.at(10.0)
    assert boxes[:, 2] == pytest.approx(boxes[:, 5] / 2)
    assert (np.abs(boxes[:, 6]) <= np.pi).all()
    ids = [t.vehicle_id for t in traffic.trajectories]
    assert len(set(ids)) == len(ids)
    assert len(present) == len(boxes)


def test_the_same_seed_gives_the_same_traffic_and_another_does_not() -> None:
    layout = make_layout(3)
    _, one = simulate_traffic(layout, 3, 2.0, SignalProgram(22.0)).at(1.0)
    _, again = simulate_traffic(layout, 3, 2.0, SignalProgram(22.0)).at(1.0)
    _, other = simulate_traffic(layout, 4, 2.0, SignalProgram(22.0)).at(1.0)
    assert np.array_equal(one, again)
    assert one.shape != other.shape or not np.allclose(one, other)


def test_no_traffic_without_density() -> None:
    traffic = simulate_traffic(make_layout(3), 3, 2.0, SignalProgram(22.0), density=0.0, parked=0)
    present, boxes = traffic.at(1.0)
    assert present == []
    assert boxes.shape == (0, 7)
