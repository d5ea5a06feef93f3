from __future__ import annotations

import numpy as np
import pytest

from wibam_core.documents.metrics import Reliability
from wibam_core.evaluation.reliability import LEVELS, reliability
from wibam_core.evaluation.uncertainty import (
    FACTOR_LIMITS,
    GROUPS,
    SdFactors,
    laplace_quantile,
    normal_quantile,
    scale_factor,
)
from wibam_core.scene import Vehicles3D

FACTORS = SdFactors(position=2.0, z=0.5, size=0.8, yaw=3.0)


def stated_and_made(factors: SdFactors, seed: int = 0, count: int = 6000) -> tuple[np.ndarray, np.ndarray]:
    """Laplace errors (N, 7), and standard deviations (N, 7) that are wrong by ``factors``."""
    rng = np.random.default_rng(seed)
    right = rng.uniform(0.1, 0.6, (count, 7))
    return rng.laplace(0, right / np.sqrt(2)), right / factors.columns()


def test_quantiles_hold_their_share_of_the_distributions() -> None:
    rng = np.random.default_rng(0)
    laplace, normal = rng.laplace(0, 1 / np.sqrt(2), 200_000), rng.normal(0, 1, 200_000)
    for share in LEVELS:
        assert np.mean(np.abs(laplace) <= laplace_quantile(share)) == pytest.approx(share, abs=0.005)
        assert np.mean(np.abs(normal) <= normal_quantile(share)) == pytest.approx(share, abs=0.005)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_known_factors_are_recovered(seed: int) -> None:
    found = SdFactors.of(*stated_and_made(FACTORS, seed))
    for name in GROUPS:
        assert getattr(found, name) == pytest.approx(getattr(FACTORS, name), rel=0.05), name


def test_few_errors_count_less_than_what_was_learned() -> None:
    errors, sd = stated_and_made(FACTORS, count=150)
    few, many = SdFactors.of(errors, sd), SdFactors.of(*stated_and_made(FACTORS))
    assert few.yaw == pytest.approx(np.sqrt(FACTORS.yaw), rel=0.15)
    assert 1 < few.yaw < many.yaw


def test_a_tenth_of_gross_errors_changes_factors_little() -> None:
    errors, sd = stated_and_made(FACTORS)
    errors[::10] += 40.0
    errors[::10, 6] = np.pi
    found = SdFactors.of(errors, sd)
    for name in GROUPS:
        assert getattr(found, name) == pytest.approx(getattr(FACTORS, name), rel=0.25), name


def test_factors_are_held_to_their_limits() -> None:
    errors, sd = stated_and_made(SdFactors(position=50.0, size=0.01))
    found = SdFactors.of(errors, sd)
    assert (found.size, found.position) == FACTOR_LIMITS


def test_too_few_errors_or_no_standard_deviation_tell_nothing() -> None:
    errors, sd = stated_and_made(FACTORS, count=20)
    found = SdFactors.of(errors, sd)
    assert found.yaw == found.z == 1.0  # 20 of each
    assert found.position != 1.0  # 40
    assert SdFactors.of(errors, np.full((20, 7), np.nan)) == SdFactors()
    assert scale_factor(np.empty(0), np.empty(0)) is None


def test_factors_multiply_the_standard_deviations_alone() -> None:
    vehicles = Vehicles3D.of(5, np.array([[0, 0, 0.75, 4, 2, 1.5, 0.1]] * 2), sd=np.full((2, 7), 0.4), camera_id="a")
    scaled = FACTORS.apply(vehicles)
    np.testing.assert_allclose(scaled.sd, [[0.8, 0.8, 0.2, 0.32, 0.32, 0.32, 1.2]] * 2)
    np.testing.assert_array_equal(scaled.boxes, vehicles.boxes)
    assert (scaled.time_ns, scaled.camera_id) == (5, "a")
    unknown = FACTORS.apply(Vehicles3D.of(0, vehicles.boxes))
    assert np.isnan(unknown.sd).all()


def test_a_heading_is_never_less_certain_than_not_at_all() -> None:
    vehicles = Vehicles3D.of(0, np.array([[0, 0, 0.75, 4, 2, 1.5, 0.1]]), sd=np.full((1, 7), 2.0))
    assert FACTORS.apply(vehicles).sd[0, 6] == pytest.approx(np.pi)


def test_right_standard_deviations_are_reliable() -> None:
    errors, sd = stated_and_made(SdFactors())
    for name, found in reliability(errors, sd).items():
        of = found.model_dump()
        assert of["scale_factor"] == pytest.approx(1, rel=0.05), name
        np.testing.assert_allclose(of["coverage"]["laplace"], LEVELS, atol=0.02)
        assert of["calibration_error"]["laplace"] < 0.015
        assert of["calibration_error"]["normal"] > of["calibration_error"]["laplace"]
        assert len(of["bins"]) == 8
        assert sum(one["count"] for one in of["bins"]) == of["count"] == errors[:, GROUPS[name]].size
        for one in of["bins"]:
            assert one["rms"] == pytest.approx(one["sd"], rel=0.2)
            assert one["median"] < one["rms"]


def test_small_standard_deviations_are_too_sure_and_a_factor_mends_that() -> None:
    errors, sd = stated_and_made(FACTORS)
    before = reliability(errors, sd)["position"].model_dump()
    assert before["scale_factor"] == pytest.approx(2, rel=0.05)
    assert all(seen < level for seen, level in zip(before["coverage"]["laplace"], LEVELS, strict=True))
    after = reliability(errors, sd * SdFactors.of(errors, sd).columns())["position"].model_dump()
    assert after["calibration_error"]["laplace"] < 0.2 * before["calibration_error"]["laplace"]


def test_what_states_no_standard_deviation_has_no_reliability() -> None:
    errors, _ = stated_and_made(FACTORS, count=50)
    assert reliability(errors, np.full_like(errors, np.nan)) == {name: Reliability(count=0) for name in GROUPS}
    few = reliability(errors[:3], np.full((3, 7), 0.2))["yaw"]
    assert few.scale_factor is None
    assert len(few.bins) == 1
