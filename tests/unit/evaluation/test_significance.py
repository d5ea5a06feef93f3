from __future__ import annotations

import numpy as np
import pytest

from wibam_core.evaluation.significance import MIN_VEHICLES, bootstrap_by_vehicle, both_tests, z_test


def test_z_test_by_hand() -> None:
    before, after = np.array([0.0, 2.0, 0.0, 2.0]), np.array([1.0, 3.0, 1.0, 3.0])
    test = z_test(before, after)
    variance = 4 / 3
    assert test.z == pytest.approx(1 / np.sqrt(variance / 4 + variance / 4))
    assert test.p == pytest.approx(0.2207, abs=1e-4)  # 2 (1 − Φ(1.2247))
    assert z_test(after, before).z == pytest.approx(-test.z)


def test_z_test_without_spread_or_values() -> None:
    assert z_test(np.ones(5), np.ones(5)).p == 1
    assert z_test(np.ones(5), np.zeros(5)).p == 0
    assert np.isnan(z_test(np.ones(1), np.ones(5)).p)


def test_the_bootstrap_is_wider_when_sightings_repeat_vehicles() -> None:
    rng = np.random.default_rng(4)
    of_vehicle = rng.normal(size=12)
    values = np.repeat(of_vehicle, 40) + rng.normal(size=480) * 0.01
    vehicles = np.repeat(np.arange(12), 40)
    other_values = np.repeat(rng.normal(size=12), 40)
    other_vehicles = vehicles + 100
    by_vehicle = bootstrap_by_vehicle(values, vehicles, other_values, other_vehicles)
    by_box = bootstrap_by_vehicle(values, np.arange(480), other_values, np.arange(480) + 1000)
    assert by_vehicle.high - by_vehicle.low > 3 * (by_box.high - by_box.low)
    # where every sighting is a vehicle of its own both tests agree
    z = z_test(values, other_values)
    half = (by_box.high - by_box.low) / 2
    assert half == pytest.approx(1.96 * by_box.difference / z.z, rel=0.15)


def test_a_common_error_of_each_vehicle_cancels_between_detectors() -> None:
    rng = np.random.default_rng(1)
    ids = np.repeat(np.arange(15), 10)
    common = np.repeat(rng.normal(size=15), 10)
    result = bootstrap_by_vehicle(common, ids, common + 0.1, ids)
    assert (result.low, result.difference, result.high) == pytest.approx((0.1, 0.1, 0.1))
    assert result.p < 0.01


def test_seeded_and_nan_without_values() -> None:
    values, ids = np.arange(10.0), np.arange(10)
    one = bootstrap_by_vehicle(values, ids, values[::-1] ** 2, ids, seed=3)
    assert one == bootstrap_by_vehicle(values, ids, values[::-1] ** 2, ids, seed=3)
    assert one != bootstrap_by_vehicle(values, ids, values[::-1] ** 2, ids, seed=4)
    assert np.isnan(bootstrap_by_vehicle(values, ids, np.empty(0), np.empty(0, int)).p)


@pytest.mark.parametrize("vehicles", [1, MIN_VEHICLES - 1])
def test_a_few_vehicles_tell_a_difference_and_not_how_sure_it_is(vehicles: int) -> None:
    ids = np.repeat(np.arange(vehicles), 50)
    result = both_tests(np.zeros(len(ids)), ids, np.full(len(ids), 0.3), ids)
    assert result.difference == pytest.approx(0.3)
    assert result.low is result.high is result.p_bootstrap is None
    assert result.vehicles == vehicles and result.is_of_too_few


def test_vehicles_of_one_detector_alone_make_the_other_no_surer() -> None:
    many, one = np.arange(40), np.zeros(40, int)
    assert both_tests(np.zeros(40), many, np.ones(40), one).p_bootstrap is None
    assert both_tests(np.zeros(40), one, np.ones(40), many).vehicles == 1


@pytest.mark.parametrize(("vehicles", "least"), [(6, 1 / 32), (7, 1 / 64), (8, 1 / 128), (20, 0.0)])
def test_no_p_is_below_that_of_all_vehicles_changing_alike(vehicles: int, least: float) -> None:
    """Which, of n vehicles, is that of n coins: 2 / 2^n, on both sides."""
    ids = np.repeat(np.arange(vehicles), 30)
    result = both_tests(np.zeros(len(ids)), ids, np.full(len(ids), 0.3), ids)
    assert not result.is_of_too_few
    assert result.p_bootstrap == pytest.approx(max(least, 2 / 2001))


def test_nothing_to_compare_is_not_too_few() -> None:
    nothing = np.empty(0)
    result = both_tests(nothing, nothing.astype(int), np.ones(3), np.arange(3))
    assert result.difference is None and result.vehicles == 0 and not result.is_of_too_few
