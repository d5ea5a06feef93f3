from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Track
from wibam_core.tracking.hota import ALPHAS, hota


def track(track_id: int, times: range, y: float = 0.0, shift: float = 0.0) -> Track:
    n = len(times)
    boxes = np.array([[t + shift, y, 0.75, 4.0, 2.0, 1.5, 0.0] for t in times])
    return Track(track_id, RoadUserClass.CAR, np.array(times), boxes, np.ones((n, 7)), np.zeros((n, 2)), np.zeros(n))


def test_the_truth_is_perfect() -> None:
    truth = [track(0, range(10)), track(1, range(5, 20), 10.0)]
    score = hota(truth, truth[::-1])
    assert (score.hota, score.det_a, score.ass_a, score.loc_a) == pytest.approx((1, 1, 1, 1))


def test_half_of_a_track_by_hand() -> None:
    score = hota([track(0, range(10))], [track(0, range(5))])
    assert score.det_a == pytest.approx(0.5)
    assert score.ass_a == pytest.approx(0.5)
    assert score.hota == pytest.approx(0.5)


def test_a_track_broken_in_two_keeps_detection_and_loses_association() -> None:
    score = hota([track(0, range(10))], [track(0, range(5)), track(1, range(5, 10))])
    assert score.det_a == pytest.approx(1)
    assert score.ass_a == pytest.approx(0.5)
    assert score.hota == pytest.approx(np.sqrt(0.5))


def test_swapped_identities_cost_association_alone() -> None:
    truth = [track(0, range(10)), track(1, range(10), 10.0)]
    a, b = truth
    swapped = [
        replace(a, boxes=np.concatenate([a.boxes[:5], b.boxes[5:]])),
        replace(b, boxes=np.concatenate([b.boxes[:5], a.boxes[5:]])),
    ]
    score = hota(truth, swapped)
    assert score.det_a == pytest.approx(1)
    assert score.ass_a == pytest.approx(5 / 15)


def test_a_false_track_costs_detection() -> None:
    score = hota([track(0, range(10))], [track(0, range(10)), track(1, range(10), 50.0)])
    assert score.det_a == pytest.approx(0.5)
    assert score.ass_a == pytest.approx(1)


def test_localisation_decides_the_thresholds_that_count() -> None:
    score = hota([track(0, range(10))], [track(0, range(10), shift=4 / 3)])  # IoU 1/2
    assert score.loc_a == pytest.approx(0.5 * np.mean(ALPHAS <= 0.5 + 1e-9))
    assert score.hota == pytest.approx(np.mean(ALPHAS <= 0.5 + 1e-9))


def test_nothing_found_or_nothing_there() -> None:
    assert hota([track(0, range(3))], []).hota == 0
    assert hota([], [track(0, range(3))]).hota == 0
