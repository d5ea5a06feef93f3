"""The brute force that says which conflicts simulated traffic has."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.conflict_truth import States, _encroachments

PERIOD_S = 0.08


def straight(number: int, course_rad: float, speed_mps: float, at_s: float) -> States:
    """A car 4.5 m long and 1.8 m wide whose middle passes the origin at that time."""
    times = np.arange(0.0, 12.0, PERIOD_S)
    way = (times - at_s) * speed_mps
    ahead = np.array([np.cos(course_rad), np.sin(course_rad)])
    n = len(times)
    size = np.tile([4.5, 1.8, 1.5], (n, 1))
    boxes = np.column_stack([way[:, None] * ahead, np.full(n, 0.75), size, np.full(n, course_rad)])
    return States(number, 0, boxes, np.tile(speed_mps * ahead, (n, 1)), np.zeros(n))


@pytest.mark.parametrize("gap_s", [0.6, 1.37, 1.45])
def test_time_between_leaving_and_reaching_is_exact(gap_s: float) -> None:
    # one at 10 m/s has left the other's way once its rear is 0.9 m beyond the origin; the other, at 5 m/s, reaches that
    # one's way with its front 0.9 m before the origin
    leaves_s = 4.0 + (2.25 + 0.9) / 10.0
    arrives_s = leaves_s + gap_s
    other_at_s = arrives_s + (2.25 + 0.9) / 5.0
    vehicles = [straight(1, 0.0, 10.0, 4.0), straight(2, np.pi / 2, 5.0, other_at_s)]
    found = _encroachments(vehicles, 1.5)
    assert found[1, 2][0] == pytest.approx(gap_s, abs=0.02)


def test_longer_times_and_followers_are_no_encroachments() -> None:
    late = straight(2, np.pi / 2, 5.0, 4.0 + 0.315 + 0.63 + 1.55)
    assert _encroachments([straight(1, 0.0, 10.0, 4.0), late], 1.5) == {}
    assert _encroachments([straight(1, 0.0, 10.0, 4.0), straight(2, 0.0, 10.0, 5.0)], 1.5) == {}
