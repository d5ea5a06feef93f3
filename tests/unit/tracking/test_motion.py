"""Laws of the models of motion: each Jacobian is the derivative of its step, and time runs both ways."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.tracking.models import model_of
from wibam_core.tracking.motion import STATES, YAW, Belief, Measurement, MotionModel, update
from wibam_core.tracking.smoother import smooth

ROAD_USERS = st.sampled_from(CLASSES)
STATE = st.tuples(
    st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1), st.floats(-15, 15), st.floats(-0.2, 0.2)
).map(np.array)
STEP_S = st.floats(0.02, 1.0)


def usual(road_user: RoadUserClass) -> MotionModel:
    return model_of(CLASSES.index(road_user), road_user.traits.size.size_m[0])


def certain(mean: np.ndarray) -> Belief:
    return Belief(mean, 1e-4 * np.eye(STATES))


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    off = a - b
    off[YAW] = normalise_angle(off[YAW])
    return off


@given(ROAD_USERS, STATE, STEP_S)
def test_the_jacobian_of_a_step_is_its_derivative(road_user: RoadUserClass, mean: np.ndarray, dt_s: float) -> None:
    model = usual(road_user)
    jacobian = model.predict(certain(mean), dt_s)[1]
    for k in range(STATES):
        step = 1e-5 * np.eye(STATES)[k]
        ahead, back = (model.predict(certain(mean + sign * step), dt_s)[0].mean for sign in (1, -1))
        np.testing.assert_allclose(jacobian[:, k], difference(ahead, back) / 2e-5, atol=1e-4)


@given(ROAD_USERS, STATE)
def test_the_jacobian_of_the_centre_is_its_derivative(road_user: RoadUserClass, mean: np.ndarray) -> None:
    model = usual(road_user)
    jacobian = model.centre(mean)[1]
    for k in range(STATES):
        step = 1e-5 * np.eye(STATES)[k]
        ahead, back = (model.centre(mean + sign * step)[0] for sign in (1, -1))
        np.testing.assert_allclose(jacobian[:, k], (ahead - back) / 2e-5, atol=1e-4)


@given(ROAD_USERS, STATE)
def test_the_velocity_is_what_a_short_step_moves_the_centre_by(road_user: RoadUserClass, mean: np.ndarray) -> None:
    model = usual(road_user)
    velocity, yaw_rate = model.velocity(mean)
    dt_s = 1e-5
    moved = (model.centre(model.predict(certain(mean), dt_s)[0].mean)[0] - model.centre(mean)[0]) / dt_s
    np.testing.assert_allclose(velocity, moved[:2], atol=0.01)
    assert yaw_rate == pytest.approx(moved[2], abs=0.01)


@given(ROAD_USERS, STATE, STEP_S)
def test_uncertainty_grows_with_time_and_shrinks_with_a_measurement(
    road_user: RoadUserClass, mean: np.ndarray, dt_s: float
) -> None:
    model = usual(road_user)
    first = model.first_belief(Measurement(mean[:3], np.array([0.3, 0.3, 0.1])))
    np.testing.assert_allclose(model.centre(first.mean)[0], mean[:3], atol=1e-9)
    later = model.predict(first, dt_s)[0]
    assert np.linalg.eigvalsh(later.covariance).min() > 0
    assert np.trace(later.covariance[:2, :2]) > np.trace(first.covariance[:2, :2])
    seen = update(model, later, Measurement(model.centre(later.mean)[0], np.array([0.3, 0.3, 0.1])))
    assert np.trace(seen.covariance[:2, :2]) < np.trace(later.covariance[:2, :2])


def test_many_move_as_each_would_alone() -> None:
    rng = np.random.default_rng(0)
    lengths = np.array([1, 7, 3, 12, 7])
    model = model_of(rng.integers(0, len(CLASSES), 5), rng.uniform(3, 12, 5))
    of_state = np.repeat(np.arange(5), lengths)
    first = np.cumsum(lengths) - lengths
    times_ns = np.cumsum(rng.integers(50_000_000, 400_000_000, len(of_state)))
    value = rng.normal(size=(len(of_state), 3)) + times_ns[:, None] * 1e-9
    measurements = Measurement(value, rng.uniform(0.1, 0.5, (len(of_state), 3)))
    measured = rng.random(len(of_state)) < 0.6
    measured[first] = True
    stands = np.repeat(rng.random(len(of_state) // 2) < 0.5, 2)
    together = smooth(model, lengths, times_ns, measurements, measured, stands)
    for number in range(5):
        own = np.flatnonzero(of_state == number)
        one, seen = model.where(np.array([number])), measurements.where(own)
        alone = smooth(one, lengths[[number]], times_ns[own], seen, measured[own], stands[own])
        np.testing.assert_allclose(together.mean[own], alone.mean, atol=1e-12)
        np.testing.assert_allclose(together.covariance[own], alone.covariance, atol=1e-12)


@given(ROAD_USERS, STATE, STEP_S)
def test_smoothing_leaves_what_the_filter_knew_last_and_knows_more_before(
    road_user: RoadUserClass, mean: np.ndarray, dt_s: float
) -> None:
    model = usual(road_user)
    start = Measurement(mean[:3], np.array([0.3, 0.3, 0.1]))
    first = model.first_belief(start)
    expected = model.predict(first, dt_s)[0]
    end = Measurement(model.centre(expected.mean)[0] + np.array([0.2, -0.1, 0.05]), start.sd)
    filtered = update(model, expected, end)
    both = Measurement(np.array([start.value, end.value]), np.array([start.sd, end.sd]))
    one = model_of([CLASSES.index(road_user)], [road_user.traits.size.size_m[0]])
    times_ns = np.array([0, round(dt_s * 1e9)])
    smoothed = smooth(one, np.array([2]), times_ns, both, np.array([True, True]), np.array([False, False]))
    np.testing.assert_allclose(smoothed.mean[1], filtered.mean, atol=1e-6)
    np.testing.assert_allclose(smoothed.covariance[1], filtered.covariance, atol=1e-6)
    assert np.trace(smoothed.covariance[0]) < np.trace(first.covariance)


@given(ROAD_USERS, STATE)
def test_who_is_seen_to_stand_has_no_speed_and_a_place_known_no_worse(
    road_user: RoadUserClass, mean: np.ndarray
) -> None:
    model = usual(road_user)
    moving = model.predict(model.first_belief(Measurement(mean[:3], np.array([0.3, 0.3, 0.1]))), 0.5)[0]
    halted = model.halted(Belief(moving.mean + 0.1, moving.covariance))
    assert np.hypot(*model.travel(halted.mean)[0]) < 0.01
    assert model.speed_sd(halted) < 0.06
    assert np.linalg.eigvalsh(moving.covariance - halted.covariance).min() > -1e-9


def test_some_who_walk_among_some_who_drive_move_as_each_alone() -> None:
    rng = np.random.default_rng(0)
    classes = np.array([6, 0, 5, 6, 3])
    assert CLASSES[6] is RoadUserClass.PEDESTRIAN
    lengths = np.array([CLASSES[k].traits.size.size_m[0] for k in classes])
    measurement = Measurement(rng.normal(size=(5, 3)), np.full((5, 3), 0.3))
    speeds = rng.normal(size=(5, 2)) * [3.0, 0.1]

    def moved(model: MotionModel, seen: Measurement, speed: np.ndarray) -> tuple[np.ndarray, ...]:
        first = model.first_belief(seen)
        first.mean[..., 3:] = speed
        later, step = model.predict(first, 0.3)
        known = update(model, later, Measurement(seen.value + 0.2, seen.sd))
        return (known.mean, known.covariance, step, *model.centre(known.mean), *model.velocity(known.mean),
                *model.travel(known.mean), model.speed_sd(known), model.turns_freely)  # fmt: skip

    mixed = model_of(classes, lengths)
    together = moved(mixed, measurement, speeds)
    for row in range(5):
        alone = moved(model_of(classes[row], lengths[row]), measurement.where(row), speeds[row])
        picked = moved(mixed.where(np.array([row])), measurement.where(np.array([row])), speeds[[row]])
        for many, one, of_one in zip(together, alone, picked, strict=True):
            np.testing.assert_allclose(many[row], one, atol=1e-12)
            np.testing.assert_allclose(of_one[0], one, atol=1e-12)
