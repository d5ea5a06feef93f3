"""What rounding to frames does to clocks: cameras and signals that are in step with each other."""

import numpy as np
import pytest

from wibam_core.clocks import SignalChange
from wibam_core.sync.offsets import estimate_clocks
from wibam_core.sync.rounding import regular_times, rounding_covariance

KINDS = (("s", "red", "green"), ("s", "green", "amber"), ("s", "amber", "red"))


def seen(camera_id, events, start_s, drift, fps, phase):
    """The frame intervals that hold the events (true s, kind), on a clock that is started at ``start_s``."""
    found = []
    for true_s, (signal, before, after) in events:
        local = (true_s - start_s) * (1 + drift)
        middle = phase + (np.floor((local - phase) * fps) + 0.5) / fps
        found.append(SignalChange(camera_id, signal, round(middle * 1e9), before, after, 0.9, round(0.5e9 / fps)))
    return found


def cycles(rng, step_s=0.5, varied=False):
    """Ten cycles whose phases last for multiples of a step."""
    found, now_s = [], rng.uniform(0, 10)
    for _ in range(10):
        for kind, lasts_s in zip(KINDS, (12.0, 3.0, 15.0), strict=True):
            found.append((now_s, kind))
            now_s += lasts_s + (step_s * rng.integers(-40, 40) if varied and kind[2] != "amber" else 0.0)
    return found


@pytest.mark.parametrize(("fps", "varied", "drift"), [(25.0, False, 0.0), (50.0, True, 1e-5), (30.0, False, 3e-5)])
def test_standard_deviations_hold_where_frames_are_in_step_with_the_signal(fps, varied, drift):
    """Ten cycles tell no more than one: at 25 frames per second all changes are wrong by the same up to 40 ms."""
    rng = np.random.default_rng(0)
    errors, sds = [], []
    for _ in range(60):
        events = cycles(rng, 0.1, varied)
        first = seen("a", events, 0.0, 0.0, fps, rng.uniform(0, 1 / fps))
        second = seen("b", events, 2.0, drift, fps, rng.uniform(0, 1 / fps))
        result = estimate_clocks({"a": first, "b": second}, "a", max_offset_s=5.0)
        at_s = float(np.mean([true_s for true_s, _ in events]))
        local_s = (at_s - 2.0) * (1 + drift)
        errors.append(int(result.clocks["b"].to_reference_ns(round(local_s * 1e9))) / 1e9 - at_s)
        sds.append(result.sd_s("b", local_s))
    scaled = np.abs(np.array(errors)) / np.array(sds)
    assert (scaled < 2).mean() >= 0.9
    assert 0.4 < np.sqrt((scaled**2).mean()) < 1.5


def test_changes_that_follow_each_other_after_the_same_time_lose_their_errors():
    rng = np.random.default_rng(1)
    starts = np.cumsum(rng.uniform(25, 35, 12))
    true_s = np.sort(np.concatenate([starts, starts + 3.0]))
    kinds = [KINDS[1], KINDS[2]] * len(starts)
    noisy = true_s + rng.uniform(-0.02, 0.02, len(true_s))
    times, sets = regular_times(kinds, noisy, np.full(len(noisy), 0.0115))
    lasted = times[1::2] - times[::2]
    assert np.ptp(lasted) < 1e-9 and lasted[0] == pytest.approx(3.0, abs=0.012)
    assert (sets[::2] == sets[1::2]).all() and len(np.unique(sets)) == len(starts)


def test_times_on_the_grid_of_a_controller_are_put_there_and_others_are_not():
    rng = np.random.default_rng(2)
    steps = np.sort(rng.choice(6000, 50, replace=False))
    kinds = [("s", str(k), "") for k in range(50)]
    noise = rng.uniform(-0.01, 0.01, 50)
    times, sets = regular_times(kinds, 0.1 * steps * (1 + 3e-4) + 0.031 + noise, np.full(50, 0.006))
    assert np.abs(np.diff(times) - 0.1 * np.diff(steps)).max() < 3e-4 * 600
    assert np.std(times - 0.1 * steps * (1 + 3e-4)) < 0.003
    assert len(np.unique(sets)) == 1
    anywhere = np.sort(rng.uniform(0, 600, 50))
    kept, apart = regular_times(kinds, anywhere, np.full(50, 0.006))
    np.testing.assert_array_equal(kept, anywhere)
    assert len(np.unique(apart)) == 50


def test_the_covariance_is_that_of_one_draw_or_of_many():
    """The mean of 16 changes: as exact as one where all meet the same phase, four times as exact where none does."""
    gain, half, camera = np.full((1, 16), 1 / 16), np.full(16, 0.02), np.zeros(16, np.int64)
    one = 0.02**2 / 3
    for together, expected in ((np.zeros(16, np.int64), one), (np.arange(16), one / 16)):
        found = rounding_covariance(gain, camera, together, half, np.zeros(16), np.zeros((1, 16)))
        assert found[0, 0] == pytest.approx(expected, rel=0.02)
    hidden = np.where(np.arange(16) == 3, 0.2, half)
    found = rounding_covariance(gain, camera, np.zeros(16, np.int64), hidden, np.zeros(16), np.zeros((1, 16)))
    assert found[0, 0] == pytest.approx((15 / 16) ** 2 * one + 0.2**2 / 3 / 256, rel=0.02)
