"""Probabilities of conflicts, by versions of what tracks say, and where such statements are made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.unit.safety.test_conflicts import straight
from wibam_core.config import SafetyConfig
from wibam_core.road_users import RoadUserClass
from wibam_core.safety import evidence, pairs
from wibam_core.safety.area import SeenGround, analysable_area
from wibam_core.safety.conflicts import find_conflicts
from wibam_core.safety.measured_errors import measured_errors
from wibam_core.safety.pairs import approaching, crossing
from wibam_core.safety.pet import paths_cross
from wibam_core.safety.track_errors import TrackErrors, draw
from wibam_core.scene import Track, Vehicles3D

HZ = 12.5


def track(track_id: int, x: np.ndarray, y: np.ndarray, sd_m: float, sd_deg: float) -> Track:
    n = len(x)
    velocity = np.stack([np.gradient(x, 1 / HZ), np.gradient(y, 1 / HZ)], axis=1)
    yaw = np.where(np.hypot(*velocity.T) > 0.5, np.arctan2(velocity[:, 1], velocity[:, 0]), 0.0)
    boxes = np.stack([x, y, np.full(n, 0.75), np.full(n, 4.5), np.full(n, 1.8), np.full(n, 1.5), yaw], axis=1)
    sd = np.tile([sd_m, sd_m, 0.05, 0.1, 0.05, 0.05, np.radians(sd_deg)], (n, 1))
    times = np.round(np.arange(n) / HZ * 1e9).astype(np.int64)
    return Track(track_id, RoadUserClass.CAR, times, boxes, sd, velocity, np.gradient(yaw, 1 / HZ))


@pytest.mark.parametrize("swerves_s", [1.5, 1.2, 1.0, 0.8])
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize(("sd_m", "sd_deg"), [(0.0, 0.0), (0.1, 2.0), (0.2, 3.0), (0.3, 5.0)])
def test_who_swerves_at_the_last_moment_was_in_conflict(
    swerves_s: float, smooth: bool, sd_m: float, sd_deg: float
) -> None:
    # at 14 m/s towards a standing car; the front is 60 m - half of two lengths before it
    t = np.arange(0, 7, 1 / HZ)
    since = np.clip(t - ((60.0 - 4.5) / 14.0 - swerves_s), 0, None)
    late = np.clip(since - 0.93, 0, 0.93)
    swung = np.where(since < 0.93, 2 * since**2, 2 * 0.93**2 + 3.72 * late - 2 * late**2)
    y = swung if smooth else np.minimum(3.0 * since, 3.5)
    moving, standing = track(1, 14 * t - 60.0, y, sd_m, sd_deg), track(2, 0 * t, 0 * t, sd_m, sd_deg)
    (conflict,) = find_conflicts([moving, standing], SafetyConfig())
    assert conflict.kind == "rear_end"
    assert conflict.ttc_s < swerves_s + 0.35
    assert conflict.ttc_probability >= 0.5


def test_a_pass_of_which_tracks_cannot_tell_is_as_probable_as_it_is() -> None:
    # Beside a standing car of the same width, off by 2.2 m: 0.4 m more than both halves. Whether the middles are nearer
    # than 1.8 m is a matter of both places' errors across: 0.3 m each for half a second or more.
    t = np.arange(0, 7, 1 / HZ)
    moving, standing = track(1, 14 * t - 60.0, 0 * t + 2.2, 0.3, 0.0), track(2, 0 * t, 0 * t, 0.3, 0.0)
    (conflict,) = find_conflicts([moving, standing], SafetyConfig(min_probability=0.0))
    assert 0.15 < conflict.ttc_probability < 0.9
    sure = [replace(one, sd=one.sd * 0.05) for one in (moving, standing)]
    assert find_conflicts(sure, SafetyConfig()) == []


def test_versions_err_as_much_as_stated_and_their_speeds_follow_their_places() -> None:
    one = track(1, np.arange(40) * 0.8, np.zeros(40), 0.3, 2.0)
    rows = np.arange(40)
    drawn = draw(one, rows, TrackErrors(along_s=0.8, across_s=0.8), 2000, np.random.default_rng(0))
    errors = drawn.boxes[..., :2] - one.boxes[:, :2]
    assert errors.std(axis=(0, 1)) == pytest.approx([0.3, 0.3], rel=0.07)
    # after 0.8 s, exp(-1/2) of an error is left
    lag = int(0.8 * HZ)
    kept = (errors[:, lag:] * errors[:, :-lag]).mean() / (errors**2).mean()
    assert kept == pytest.approx(np.exp(-0.5), abs=0.05)
    slopes = np.gradient(drawn.boxes[..., 0], 1 / HZ, axis=1)[:, 1:-1]
    assert drawn.velocities[:, 1:-1, 0] == pytest.approx(slopes, abs=0.05)


def test_errors_are_measured_by_fits() -> None:
    rng = np.random.default_rng(1)
    tracks, fits = [], []
    times = np.arange(0, 60) * 80_000_000
    for number in range(12):
        one = track(number, np.arange(60) * 0.8, np.full(60, 20.0 * number), 0.2, 2.0)
        # the place errs by three times what is stated, for 0.5 s or so
        noise = np.convolve(rng.normal(size=90), np.ones(9) / 3.0, mode="same")[15:75]
        boxes = one.boxes.copy()
        boxes[:, 0] += 0.6 * noise
        tracks.append(replace(one, boxes=boxes))
    for k in range(0, 60, 5):
        truth = np.array([[k * 0.8, 20.0 * n, 0.75, 4.5, 1.8, 1.5, 0.0] for n in range(12)])
        fits.append(Vehicles3D.of(int(times[k]), truth, sd=np.full((12, 7), 0.02)))
    found = measured_errors(tracks, fits, TrackErrors())
    assert found.along > 1.3  # 3, drawn to 1 by few comparisons
    assert found.across < 0.95  # none at all
    assert measured_errors(tracks, [], TrackErrors(along=1.7)) == TrackErrors(along=1.7)


def test_nothing_is_left_out_before_the_exact_measures() -> None:
    t = np.arange(0, 7, 1 / HZ)
    ahead, behind = track(1, 14 * t - 60.0, 0 * t, 0.1, 1.0), track(2, 0 * t, 0 * t, 0.1, 1.0)
    far = track(3, 14 * t, 0 * t + 60, 0.1, 1.0)
    pairs = approaching([ahead, behind, far], SafetyConfig(), TrackErrors(), lambda *_, **__: None)
    assert set(pairs) == {(0, 1)}
    # from where braking by 3 m/s² is needed: 14² / 6 = 33 m before
    assert pairs[0, 1][0] * 1e-9 <= (60.0 - 4.5 - 33.0) / 14.0
    across = track(4, 0 * t - 30.0, 10 * t - 20.0, 0.1, 1.0)
    assert crossing([ahead, behind, across], 1.5, np.radians(30), 1.0) == {(0, 2)}


def test_who_turns_into_a_lane_behind_another_does_not_cross_its_path() -> None:
    x = np.linspace(-20, 20, 80)
    lane = np.stack([x, 0 * x], axis=1)
    angle = np.linspace(0, np.pi / 2, 40)
    merges = np.stack([-10 * np.cos(angle), -10 + 10 * np.sin(angle)], axis=1)
    merges = np.concatenate([merges, np.stack([np.linspace(0.5, 20, 40), 0 * angle + 0.1], axis=1)])
    crosses = np.stack([0 * x + 1.0, x], axis=1)
    assert not paths_cross(lane, merges, np.radians(30))
    assert paths_cross(lane, crosses, np.radians(30))
    assert not paths_cross(lane, np.tile([[1.0, 0.0]], (50, 1)), np.radians(30))


def test_the_area_is_where_many_pass_and_few_are_lost() -> None:
    # three drive through; beyond x = 30 m places are uncertain, and at y = 40 m every track begins and ends
    tracks = []
    for number in range(6):
        one = straight(number, (-40.0, 0.5 * number), 0.0, 10.0, seconds=10.0, begin_s=3.0 * number, sd=0.2)
        one.sd[one.boxes[:, 0] > 30] = 0.9
        tracks.append(one)
    for number in range(6, 12):
        tracks.append(straight(number, (0.0, 40.0), 0.0, 4.0, seconds=2.0, begin_s=3.0 * (number - 6) + 2, sd=0.2))
    area = analysable_area(tracks, SafetyConfig())
    assert area.holds(np.array([[0.0, 1.0], [15.0, 1.0]])).all()
    assert not area.holds(np.array([[45.0, 1.0], [4.0, 40.0], [0.0, 20.0], [500.0, 0.0]])).any()
    assert area.road_user_km == pytest.approx(6 * 0.055, rel=0.3)
    # what the outlines enclose, less the holes, is the area
    shoelace = 0.0
    for ring in area.outlines():
        p = np.array(ring)
        shoelace += 0.5 * float(np.sum(p[:, 0] * np.roll(p[:, 1], -1) - p[:, 1] * np.roll(p[:, 0], -1)))
    assert abs(shoelace) == pytest.approx(area.area_m2, rel=0.25)


def test_no_tracks_no_area() -> None:
    area = analysable_area([], SafetyConfig())
    assert (area.area_m2, area.outlines()) == (0.0, [])


def test_what_is_left_out_early_would_not_have_been_told(monkeypatch: pytest.MonkeyPatch) -> None:
    # eight times somebody comes up to one who stands, and passes at once, sooner or later, with more room or less
    t, tracks = np.arange(0, 6, 1 / HZ), []
    for number, room in enumerate(np.linspace(1.2, 4.5, 8)):
        aside = room * np.clip(t - (55.5 / 14.0 - 0.8 - 0.08 * number), 0.0, 1.0)
        tracks.append(track(2 * number, 14 * t - 60.0, 100.0 * number + aside, 0.15, 2.0))
        tracks.append(track(2 * number + 1, 0 * t, 0 * t + 100.0 * number, 0.15, 2.0))
    config = SafetyConfig(max_overlap_iou=1.0)
    told = find_conflicts(tracks, config)
    assert 2 < len(told) < 8
    monkeypatch.setattr(pairs, "_may_be_critical", lambda every, i, j, config, errors: np.ones(len(i), bool))
    monkeypatch.setattr(evidence, "_NEXT_TO_IMPOSSIBLE", -1.0)
    assert find_conflicts(tracks, config) == told


def test_ground_seen_in_stretches_is_the_ground_seen_at_once() -> None:
    rng, tracks = np.random.default_rng(3), []
    for number in range(60):
        t = np.arange(0, 8, 1 / HZ)
        one = track(number, 9 * t - 36, 0 * t + rng.normal(), 0.1, 1.0)
        tracks.append(replace(one, times_ns=one.times_ns + number * 3_000_000_000))
    whole = analysable_area(tracks, SafetyConfig())
    assert whole.area_m2 > 100
    end = int(tracks[-1].times_ns[-1])
    ground, step = SeenGround([(0, end)]), 50_000_000_000
    for start in range(0, end + 1, step):
        ground.see(tracks, start, start + step)
    area = ground.area(SafetyConfig())
    for start in range(0, end + 1, step):
        area = area.used_by(tracks, start, start + step)
    # somebody who crosses from one stretch into the next is counted as passing in both
    assert area.area_m2 == pytest.approx(whole.area_m2, rel=0.05)
    assert area.hours == whole.hours
    assert area.road_user_km == pytest.approx(whole.road_user_km, rel=0.05)
    again = replace(whole, road_user_hours=0.0, road_user_km=0.0)
    for start in range(0, end + 1, step):
        again = again.used_by(tracks, start, start + step)
    assert again.road_user_km == pytest.approx(whole.road_user_km)


def test_who_is_far_beyond_everybody_does_not_stretch_the_ground() -> None:
    t = np.arange(0, 8, 1 / HZ)
    tracks = [track(n, 9 * t - 36, 0 * t, 0.1, 1.0) for n in range(5)]
    area = analysable_area([*tracks, track(9, 9 * t + 4e6, 0 * t - 7e6, 0.1, 1.0)], SafetyConfig())
    assert area.cells.size < 500
    assert area.outlines() == analysable_area(tracks, SafetyConfig()).outlines()


def test_where_footage_begins_and_ends_nobody_is_lost() -> None:
    t = np.arange(0, 8, 1 / HZ)
    tracks = [track(n, 9 * t - 36, 0 * t, 0.1, 1.0) for n in range(9)]
    later = [replace(one, times_ns=one.times_ns + 100_000_000_000) for one in tracks]
    seconds = [(0, int(tracks[0].times_ns[-1])), (100_000_000_000, int(later[0].times_ns[-1]))]

    def area_m2(recorded_ns: list[tuple[int, int]]) -> float:
        ground = SeenGround(recorded_ns)
        ground.see([*tracks, *later])
        return ground.area(SafetyConfig()).area_m2

    assert area_m2(seconds) > 1.1 * area_m2([(seconds[0][0], seconds[1][1])])
