"""Smoothing: what lasts of the errors of cameras and of accelerations, by what all measurements say at once."""

from __future__ import annotations

import numpy as np
import pytest

from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.tracking.models import steady_model_of
from wibam_core.tracking.motion import Belief, Measurement
from wibam_core.tracking.smoother import Views, smooth

PEDESTRIAN, CAR = CLASSES.index(RoadUserClass.PEDESTRIAN), CLASSES.index(RoadUserClass.CAR)
#: What is smoothed counts so much of the variance of a camera as lasting, and for so long, s.
LASTING_SHARE, LASTING_S = 0.7, 4.0
#: The first box counts for so much less than what is measured then.
FIRST_DOUBT = 10.0


def views_of(values: np.ndarray, sd: np.ndarray, seen: np.ndarray) -> Views:
    return Views(values, np.broadcast_to(sd, values.shape).copy(), seen)


def smoothed(kinds: list[int], lengths: np.ndarray, times_ns: np.ndarray, first: Measurement, views: Views,
             stands: np.ndarray) -> Belief:  # fmt: skip
    model, accelerations = steady_model_of(kinds, [CLASSES[kind].traits.size.size_m[0] for kind in kinds])
    return smooth(model, accelerations, lengths, times_ns, first, views, stands)


def test_who_walks_is_where_all_that_is_normally_distributed_says_at_once() -> None:
    rng, n = np.random.default_rng(0), 20
    times_ns = np.cumsum(rng.integers(100_000_000, 300_000_000, n))
    time_s = times_ns * 1e-9
    way = np.stack([1.2 * (time_s - time_s[0]), np.zeros(n), np.zeros(n)], axis=1)
    seen = rng.random((n, 2)) < 0.7
    seen[0] = True
    values = way[:, None] + rng.normal(size=(1, 2, 3)) * 0.1 + rng.normal(size=(n, 2, 3)) * 0.05
    first = Measurement(values[:1, 0], np.full((1, 3), 0.3))
    views = views_of(values, np.array([0.3, 0.3, 0.3]), seen)
    found = smoothed([PEDESTRIAN], np.array([n]), times_ns, first, views, np.zeros(n, bool))

    # along x: places (n,) as a linear function of the first place and speed and of what happens at each step
    motion, dt = CLASSES[PEDESTRIAN].traits.motion, np.diff(time_s)
    columns = [np.ones(n), time_s - time_s[0]]
    variances = [(FIRST_DOUBT * 0.3) ** 2, motion.first_speed_sd_mps**2]
    for k, step_s in enumerate(dt):
        after = np.arange(n) > k
        pushed = 0.5 * step_s**2 + step_s * np.maximum(time_s - time_s[k + 1], 0.0)
        columns += [np.where(after, pushed, 0.0), after.astype(float)]
        variances += [motion.acceleration_mps2**2, motion.position_drift_m**2 * step_s]
    A = np.stack(columns, axis=1)
    C = A @ np.diag(variances) @ A.T
    instant, camera = np.nonzero(seen)
    lag_s = np.abs(time_s[instant][:, None] - time_s[instant])
    lasting = LASTING_SHARE * np.exp(-lag_s / LASTING_S) * (camera[:, None] == camera)
    R = 0.3**2 * (lasting + (1 - LASTING_SHARE) * np.eye(len(instant)))
    gain = np.linalg.solve(C[np.ix_(instant, instant)] + R, C[instant]).T
    expected = first.value[0, 0] + gain @ (values[instant, camera, 0] - first.value[0, 0])
    np.testing.assert_allclose(found.mean[:, 0], expected, atol=1e-6)
    np.testing.assert_allclose(found.covariance[:, 0, 0], np.diag(C - gain @ C[instant]), atol=1e-6)


def test_many_move_as_each_would_alone() -> None:
    rng = np.random.default_rng(0)
    lengths, kinds = np.array([1, 7, 3, 12, 7]), [CAR, PEDESTRIAN, CAR, CAR, PEDESTRIAN]
    of_state = np.repeat(np.arange(5), lengths)
    times_ns = np.cumsum(rng.integers(50_000_000, 400_000_000, len(of_state)))
    values = rng.normal(size=(len(of_state), 3, 3)) + times_ns[:, None, None] * 1e-9
    seen = rng.random((len(of_state), 3)) < 0.5
    stands = np.repeat(rng.random(len(of_state) // 2) < 0.5, 2) & (np.array(kinds)[of_state] == CAR)
    views = views_of(values, np.array([0.3, 0.4, 0.2]), seen)
    start = np.cumsum(lengths) - lengths
    first = Measurement(values[start, 0], np.full((5, 3), 0.3))
    together = smoothed(kinds, lengths, times_ns, first, views, stands)
    for number in range(5):
        own = np.flatnonzero(of_state == number)
        alone = smoothed(
            [kinds[number]],
            lengths[[number]],
            times_ns[own],
            first.where(np.array([number])),
            views.where(own),
            stands[own],
        )
        np.testing.assert_allclose(together.mean[own], alone.mean, atol=1e-9)
        np.testing.assert_allclose(together.covariance[own], alone.covariance, atol=1e-9)


def test_who_stands_has_one_place_and_no_speed() -> None:
    rng, n = np.random.default_rng(0), 40
    values = np.array([3.0, 4.0, 0.5]) + rng.normal(size=(n, 1, 3)) * 0.1
    views = views_of(values, np.array([0.2, 0.2, 0.1]), np.ones((n, 1), bool))
    first = Measurement(values[:1, 0], np.full((1, 3), 0.2))
    times_ns = np.arange(n) * 160_000_000
    moves, stands = (
        smoothed([CAR], np.array([n]), times_ns, first, views, np.full(n, still)) for still in (False, True)
    )
    assert np.ptp(stands.mean[:, :3], axis=0) == pytest.approx(0.0, abs=1e-9)
    assert np.abs(stands.mean[:, 3]).max() < 0.02 < np.abs(moves.mean[:, 3]).max()
    assert (stands.covariance[:, 0, 0] < moves.covariance[:, 0, 0]).all()
