"""Clocks from road users that two cameras see: ways that are made here, of known times."""

import numpy as np
import pytest

from wibam_core.clocks import SignalChange
from wibam_core.errors import UnknownClock
from wibam_core.sync.document import doubts, sync_document
from wibam_core.sync.paths import GroundPath
from wibam_core.sync.traffic import align_by_traffic
from wibam_core.sync.witnesses import synchronise

SPAN = (0.0, 180.0)


def drives(rng, count=60):
    """(begin s, heading rad, lane m, speed m/s, acceleration m/s²) of vehicles on two crossing roads, both ways."""
    return [
        (rng.uniform(0, 200), rng.integers(4) * np.pi / 2, -3.0, rng.uniform(6, 13), rng.uniform(-0.6, 0.6))
        for _ in range(count)
    ]


def seen(rng, vehicles, start_s, drift=0.0, bias_m=(0.0, 0.0), rate_hz=5.0):
    """What a camera sees that was started at ``start_s`` and whose clock is fast by ``drift``."""
    paths = []
    for begin_s, heading, lane_m, speed, gain in vehicles:
        true_s = begin_s + np.arange(rng.uniform(0, 1 / rate_hz), 7.0, 1 / rate_hz)
        local_s = (true_s - start_s) * (1 + drift)
        inside = (local_s > SPAN[0]) & (local_s < SPAN[1])
        if inside.sum() < 8 or rng.random() < 0.15:
            continue
        since = true_s[inside] - begin_s
        ahead = np.array([np.cos(heading), np.sin(heading)])
        along = -35.0 + speed * since + 0.5 * gain * since**2
        points = along[:, None] * ahead + lane_m * np.array([-ahead[1], ahead[0]]) + bias_m
        points += 0.3 * rng.standard_normal(2) + 0.05 * rng.standard_normal(points.shape)
        velocities = (speed + gain * since)[:, None] * ahead
        paths.append(GroundPath(local_s[inside], points, velocities, np.full(len(since), 0.7)))
    return paths


@pytest.mark.parametrize(("start_s", "drift"), [(0.0, 0.0), (37.0, 4e-4), (-61.5, -1e-3)])
def test_two_cameras_are_aligned_by_the_traffic_alone(start_s, drift):
    """The cameras disagree by 0.4 m about where everything is: 50 ms at 8 m/s, were it taken for time."""
    rng = np.random.default_rng(0)
    vehicles = drives(rng)
    first, second = seen(rng, vehicles, 0.0), seen(rng, vehicles, start_s, drift, bias_m=(0.3, -0.3))
    found = align_by_traffic("a", first, SPAN, "b", second, SPAN)
    assert found is not None and found.is_clear
    assert found.taken.share > 0.5
    meeting = found.meeting
    true_s = start_s + meeting.second_s / (1 + drift)
    assert meeting.first_s == pytest.approx(true_s, abs=0.05)
    assert meeting.drift == pytest.approx(1 / (1 + drift) - 1, abs=3 * meeting.drift_sd)


def test_unlike_traffic_aligns_nothing():
    rng = np.random.default_rng(1)
    first, second = seen(rng, drives(rng), 0.0), seen(rng, drives(rng), 0.0)
    found = align_by_traffic("a", first, SPAN, "b", second, SPAN)
    assert found is None or not found.is_clear
    with pytest.raises(UnknownClock, match="b is unknown") as error:
        synchronise({"a": SPAN, "b": SPAN}, "a", paths={"a": first, "b": second})
    assert error.value.details == {"cameras": ["b"]}


def fixed_cycle(camera_id, start_s, signal_id="s", period_s=20.0):
    times = [t for t in np.arange(3.0, 400.0, period_s) if 0 < t - start_s < 180.0]
    return [
        SignalChange(camera_id, signal_id, round((t - start_s) * 1e9), "red", "green", 1.0, 20_000_000) for t in times
    ]


def test_the_traffic_decides_between_whole_cycles_and_the_lights_measure():
    rng = np.random.default_rng(2)
    vehicles = drives(rng)
    paths = {"a": seen(rng, vehicles, 0.0), "b": seen(rng, vehicles, 47.0)}
    changes = {"a": fixed_cycle("a", 0.0), "b": fixed_cycle("b", 47.0)}
    spans = dict.fromkeys(paths, SPAN)
    alone = synchronise(spans, "a", changes=changes)
    assert alone.is_ambiguous
    assert alone.result.clocks["b"].offset_ns / 1e9 == pytest.approx(7.0, abs=0.05)
    both = synchronise(spans, "a", changes=changes, paths=paths)
    assert not both.is_ambiguous
    assert both.result.clocks["b"].to_reference_ns(10**11) / 1e9 == pytest.approx(147.0, abs=0.02)
    document = sync_document(changes, both.result, both.traffic, both.disagreeing)
    assert document.method == "both"
    assert document.cameras["b"].decided_by_traffic and not document.cameras["b"].ambiguous
    [pair] = document.traffic
    assert pair.clear and abs(pair.residual_s) < 0.1
    assert document.rms_after_by_change_s["red to green"] < 0.04


def test_a_camera_without_lights_joins_by_the_traffic():
    rng = np.random.default_rng(3)
    vehicles = drives(rng)
    starts = {"a": 0.0, "b": 12.0, "c": -8.0}
    paths = {camera_id: seen(rng, vehicles, start_s) for camera_id, start_s in starts.items()}
    changes = {"b": fixed_cycle("b", 12.0), "c": fixed_cycle("c", -8.0)}
    found = synchronise(dict.fromkeys(starts, SPAN), "a", changes=changes, paths=paths)
    for camera_id, start_s in starts.items():
        mapped_s = int(found.result.clocks[camera_id].to_reference_ns(90 * 10**9)) / 1e9
        assert mapped_s == pytest.approx(90.0 + start_s, abs=0.06)


def test_lights_that_contradict_the_traffic_are_left_out_and_said_to_be():
    rng = np.random.default_rng(4)
    vehicles = drives(rng)
    paths = {"a": seen(rng, vehicles, 0.0), "b": seen(rng, vehicles, 47.0)}
    uneven = np.cumsum(rng.uniform(8, 25, 12))
    changes = {
        camera_id: [SignalChange(camera_id, "s", round(t * 1e9), "red", "green", 1.0, 20_000_000) for t in times]
        for camera_id, times in (("a", uneven), ("b", uneven - 3.0))
    }
    found = synchronise(dict.fromkeys(paths, SPAN), "a", changes=changes, paths=paths)
    assert found.disagreeing == ("b",)
    assert int(found.result.clocks["b"].to_reference_ns(10**11)) / 1e9 == pytest.approx(147.0, abs=0.06)
    codes = {doubt.code for doubt in doubts(sync_document(changes, found.result, found.traffic, ("b",)), None)}
    assert "witnesses_disagree" in codes
