"""Offsets beside places that are wrong: samples that are made here, of a known offset."""

import numpy as np
import pytest

from wibam_core.sync.biases import Samples, joined, solve

OFFSET_S, DRIFT = 0.06, 2e-4


def samples(rng, count=40, field_m=0.0, own_m=0.1, noise_m=0.15, headings=4, shift_m=0.0):
    """Vehicles on crossing roads; the first camera's clock is ``OFFSET_S`` further on than thought, at 150 s."""
    parts = []
    shift = shift_m * rng.standard_normal(2) if shift_m else np.zeros(2)
    for number in range(count):
        heading = rng.integers(headings) * np.pi / 2 + rng.normal(0, 0.1)
        ahead = np.array([np.cos(heading), np.sin(heading)])
        speed = rng.uniform(4, 13)
        at_s = rng.uniform(0, 300) + np.arange(0, 6, 0.2)
        along = speed * (at_s - at_s.mean())
        point = along[:, None] * ahead + 4.0 * np.array([ahead[1], -ahead[0]])
        velocity = np.broadcast_to(speed * ahead, point.shape)
        bias = field_m * np.column_stack([np.sin(point[:, 1] / 20), np.cos(point[:, 0] / 25)])
        wrong = shift + bias + own_m * rng.standard_normal(2) + noise_m * rng.standard_normal(point.shape)
        apart = wrong - velocity * (OFFSET_S + DRIFT * (at_s - 150.0))[:, None]
        parts.append(Samples(np.full(len(at_s), number), at_s, point, velocity, apart, np.ones(len(at_s))))
    return joined(parts)


@pytest.mark.parametrize(("field_m", "own_m"), [(0.0, 0.05), (0.5, 0.2), (1.0, 0.6)])
def test_the_offset_is_found_beside_biases_and_its_standard_deviation_is_true(field_m, own_m):
    scaled = []
    for seed in range(8):
        solution, covariance = solve(samples(np.random.default_rng(seed), field_m=field_m, own_m=own_m), 150.0, 0.0)
        scaled.append((solution - (OFFSET_S, DRIFT)) / np.sqrt(np.diag(covariance)))
    rms = np.sqrt(np.square(scaled).mean(axis=0))
    assert (rms < 1.6).all() and rms[0] > 0.1


def test_cameras_that_disagree_know_less():
    rng = np.random.default_rng(0)
    sds = []
    for field_m, own_m in ((0.0, 0.02), (0.5, 0.2), (1.0, 0.8)):
        _, covariance = solve(samples(rng, field_m=field_m, own_m=own_m), 150.0, 0.0)
        sds.append(np.sqrt(covariance[0, 0]))
    assert sds[0] < 0.008 and sds[0] < sds[1] < sds[2]


def test_traffic_in_one_direction_at_one_speed_knows_little_where_cameras_disagree():
    """A bias along the road and an offset look alike there: only how large biases usually are tells them apart."""
    crossing = solve(samples(np.random.default_rng(1), field_m=0.6, own_m=0.2), 150.0, 0.0)[1]
    one_way = solve(samples(np.random.default_rng(1), field_m=0.6, own_m=0.2, headings=1), 150.0, 0.0)[1]
    assert one_way[0, 0] > 2 * crossing[0, 0]


@pytest.mark.parametrize("shift_m", [0.0, 0.4])
def test_traffic_in_one_direction_states_what_a_shift_of_all_places_leaves_open(shift_m):
    """A shift along the road and an offset look alike there, and no sample scatters by either."""
    errors, stated = [], []
    for seed in range(8):
        one_way = samples(np.random.default_rng(seed), own_m=0.15, headings=1, shift_m=shift_m)
        solution, covariance = solve(one_way, 150.0, 0.0)
        errors.append(solution[0] - OFFSET_S)
        stated.append(np.sqrt(covariance[0, 0]))
    scaled = np.array(errors) / stated
    assert np.sqrt((scaled**2).mean()) < 1.4 and np.abs(scaled).max() < 2.5
    crossing, covariance = solve(samples(np.random.default_rng(0), own_m=0.15, shift_m=shift_m), 150.0, 0.0)
    assert abs(crossing[0] - OFFSET_S) < 0.01
    assert np.sqrt(covariance[0, 0]) < 0.7 * np.mean(stated)


def test_a_vehicle_that_is_taken_for_another_hardly_counts():
    rng = np.random.default_rng(2)
    good = samples(rng, own_m=0.1)
    wrong = samples(rng, count=1)
    apart = wrong.apart_m + np.array([6.0, -4.0]) * np.linspace(-1, 1, len(wrong))[:, None]
    wrong = Samples(wrong.road_user + 99, wrong.second_s, wrong.point_m, wrong.velocity_mps, apart, wrong.sd_m)
    alone, _ = solve(good, 150.0, 0.0)
    both, _ = solve(joined([good, wrong]), 150.0, 0.0)
    assert abs(both[0] - alone[0]) < 0.01


def test_samples_that_share_their_errors_are_thinned():
    thinned = samples(np.random.default_rng(3), count=2).thinned()
    for number in (0, 1):
        assert np.diff(thinned.second_s[thinned.road_user == number]).min() > 0.59
    assert len(joined([])) == 0
