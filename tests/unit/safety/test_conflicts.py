from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.stage_folders import StageFolders
from wibam_core.artifacts.catalogue import CONFLICTS, FITS, SPLIT, TRACKS
from wibam_core.config import SafetyConfig
from wibam_core.documents.split import Split
from wibam_core.road_users import RoadUserClass
from wibam_core.safety.conflicts import ConflictType, find_conflicts
from wibam_core.safety.drac import deceleration_to_avoid
from wibam_core.safety.pet import post_encroachment
from wibam_core.safety.turning import TurningStates
from wibam_core.scene import Track
from wibam_core.site import Site
from wibam_core.stages import safety as stage

RATE_HZ = 6.25
CONFIG = SafetyConfig()


def straight(
    track_id: int, start: tuple[float, float], yaw: float, speed: float, seconds: float = 8.0, sd: float = 0.1,
    noise: float = 0.0, begin_s: float = 0.0,
) -> Track:  # fmt: skip
    t = np.arange(0, seconds, 1 / RATE_HZ)
    return from_speed(track_id, start, yaw, np.full(len(t), speed), sd, noise, begin_s)


def from_speed(
    track_id: int, start: tuple[float, float], yaw: float, speeds: np.ndarray, sd: float = 0.1, noise: float = 0.0,
    begin_s: float = 0.0,
) -> Track:  # fmt: skip
    n = len(speeds)
    rng = np.random.default_rng(track_id)
    along = np.r_[0, np.cumsum(0.5 * (speeds[1:] + speeds[:-1])) / RATE_HZ]
    direction = np.array([np.cos(yaw), np.sin(yaw)])
    boxes = np.tile([0, 0, 0.75, 4.0, 2.0, 1.5, yaw], (n, 1))
    boxes[:, :2] = np.array(start) + along[:, None] * direction + rng.normal(size=(n, 2)) * noise
    velocities = speeds[:, None] * direction + rng.normal(size=(n, 2)) * noise
    times = np.rint((begin_s + np.arange(n) / RATE_HZ) * 1e9).astype(np.int64)
    return Track(track_id, RoadUserClass.CAR, times, boxes, np.full((n, 7), sd), velocities, np.zeros(n))


def test_pet_of_a_right_angle_crossing_is_exact() -> None:
    # a's rear leaves b's lane (y < 1) at y = 3, b's front reaches a's lane (x > -1) at x = -3.
    a = straight(1, (0, -20), np.pi / 2, 10)
    b = straight(2, (-43, 0), 0.0, 10)
    found = post_encroachment(a, b)
    assert found is not None
    assert found.pet_s == pytest.approx(4.0 - 2.3, abs=0.006)
    assert found.first_index == 0
    assert (found.leaves_ns, found.arrives_ns) == (pytest.approx(2.3e9, abs=6e6), pytest.approx(4.0e9, abs=6e6))
    mirrored = post_encroachment(b, a)
    assert mirrored is not None
    assert (mirrored.pet_s, mirrored.first_index) == (pytest.approx(found.pet_s, abs=1e-9), 1)


def test_pet_is_none_for_paths_that_do_not_cross_and_zero_for_a_crash() -> None:
    assert post_encroachment(straight(1, (0, 0), 0.0, 10), straight(2, (0, 3), 0.0, 10)) is None
    crash = post_encroachment(straight(1, (-20, 0), 0.0, 10), straight(2, (0, -20), np.pi / 2, 10))
    assert crash is not None
    assert crash.pet_s == 0


def test_a_follower_does_not_encroach_when_headings_must_differ() -> None:
    a, b = straight(1, (10, 0), 0.0, 10), straight(2, (0, 0), 0.0, 10)
    follower = post_encroachment(a, b)
    assert follower is not None
    assert follower.pet_s == pytest.approx(0.6, abs=0.006)  # the gap of 6 m at 10 m/s
    assert post_encroachment(a, b, min_heading_difference_rad=0.5) is None


def test_a_crossing_conflict_says_who_when_and_how_close() -> None:
    a = straight(4, (0, -20), np.pi / 2, 10, seconds=5)
    b = straight(2, (-31, 0), 0.0, 10, seconds=5)
    (conflict,) = find_conflicts([a, b], CONFIG)
    assert conflict.track_ids == (2, 4)
    assert conflict.kind is ConflictType.CROSSING
    assert conflict.heading_difference_rad == pytest.approx(np.pi / 2)
    assert conflict.pet_s == pytest.approx(2.8 - 2.3, abs=0.006)
    assert conflict.pet.low_s < conflict.pet_s < conflict.pet.high_s
    assert conflict.speeds_mps == pytest.approx((10, 10))


def test_a_late_crossing_is_found_where_the_pet_threshold_is_the_longer_one() -> None:
    a = straight(1, (0, -20), np.pi / 2, 10, seconds=3.0)
    b = straight(2, (-13, 0), 0.0, 10, begin_s=6.4, seconds=3.0)
    config = SafetyConfig(ttc_s=3.0, pet_s=6.0)
    (conflict,) = find_conflicts([a, b], config)
    assert 3.0 < (conflict.pet_s or 0.0) < 6.0


def test_a_crash_course_has_a_small_ttc_with_its_interval() -> None:
    a = from_speed(1, (0, -40), np.pi / 2, np.r_[np.full(16, 10.0), np.linspace(10, 0, 9), np.zeros(10)])
    b = straight(2, (-40, 0), 0.0, 10, seconds=5.5)
    (conflict,) = find_conflicts([a, b], CONFIG)
    assert 0 < conflict.ttc_s < 1.5
    assert conflict.ttc.low_s <= conflict.ttc_s <= conflict.ttc.high_s
    assert conflict.probability > 0.9
    assert conflict.duration_s > 0.3


def test_intervals_grow_with_the_standard_deviation_and_repeat_with_the_seed() -> None:
    def run(sd: float) -> float:
        a = from_speed(1, (0, 0), 0.0, np.full(15, 15.0), sd=sd)
        b = from_speed(2, (40, 0), 0.0, np.full(15, 1.0), sd=sd)
        one, again = find_conflicts([a, b], CONFIG, seed=3), find_conflicts([a, b], CONFIG, seed=3)
        assert one == again
        return one[0].ttc.high_s - one[0].ttc.low_s

    assert run(0.1) > run(0.03) > 0


def test_head_on_rear_end_and_merging_are_told_apart() -> None:
    head_on = find_conflicts([straight(1, (0, 0), 0.0, 8, 2), straight(2, (40, 0), np.pi, 8, 2)], CONFIG)
    rear_end = find_conflicts([straight(1, (0, 0), 0.0, 15, 2), straight(2, (30, 0), 0.0, 3, 2)], CONFIG)
    merging = find_conflicts([straight(1, (0, 0), 0.0, 15, 1.4), straight(2, (0, 8), -0.25, 15, 1.4)],
                             CONFIG.model_copy(update={"min_deceleration_mps2": 0.0}))  # fmt: skip
    assert [c.kind for c in (*head_on, *rear_end, *merging)] == [
        ConflictType.HEAD_ON,
        ConflictType.REAR_END,
        ConflictType.MERGING,
    ]


def test_a_queue_that_rolls_up_to_a_red_light_is_no_conflict() -> None:
    stop = np.linspace(10, 0, 26)  # 2.4 m/s² of braking
    tracks = [from_speed(k, (-6.5 * k, 0), 0.0, np.r_[np.full(4 * k, 10.0), stop, np.zeros(30)], noise=0.05)
              for k in range(4)]  # fmt: skip
    for k, track in enumerate(tracks):  # each stops 6.5 m behind the one before
        shift = track.boxes[-1, 0] + 6.5 * k
        track.boxes[:, 0] -= shift
    assert find_conflicts(tracks, CONFIG) == []


def test_parked_and_queued_vehicles_with_detector_noise_are_no_conflict() -> None:
    tracks = [straight(k, (6.0 * (k % 5), 3.0 * (k // 5)), 0.0, 0.0, noise=0.15, sd=0.15) for k in range(10)]
    assert find_conflicts(tracks, CONFIG) == []


def test_oncoming_traffic_in_its_own_lane_with_noise_is_no_conflict() -> None:
    tracks = [straight(1, (0, 0), 0.0, 10, noise=0.1), straight(2, (80, 3.5), np.pi, 10, noise=0.1)]
    assert find_conflicts(tracks, CONFIG) == []


def test_a_turn_past_a_waiting_vehicle_is_no_conflict() -> None:
    # Turning left on a radius of 14 m at 10 m/s: straight on stands a vehicle that waits to come the other way.
    t = np.arange(0, 3, 1 / RATE_HZ)
    angle = 10 * t / 14
    turning = straight(1, (0, 0), 0.0, 10, seconds=3, sd=0.03)
    turning.boxes[:, 0], turning.boxes[:, 1], turning.boxes[:, 6] = 14 * np.sin(angle), 14 * (1 - np.cos(angle)), angle
    turning.velocities_mps[:] = 10 * np.column_stack([np.cos(angle), np.sin(angle)])
    waiting = straight(2, (14, 1), np.pi, 0.0, seconds=3, sd=0.03)
    assert len(find_conflicts([turning, waiting], CONFIG)) == 1  # by its yaw rate it drives straight on
    turning.yaw_rates_radps[:] = 10 / 14
    assert find_conflicts([turning, waiting], CONFIG) == []


def test_an_arc_ends_where_the_circle_says() -> None:
    state = TurningStates(np.array([[0, 0, 0.75, 4, 2, 1.5, 0.0]]), np.array([[6.0, 0.0]]), np.array([0.5]))
    (box,) = state.after(2.0)
    assert box[[0, 1, 6]] == pytest.approx([12 * np.sin(1.0), 12 * (1 - np.cos(1.0)), 1.0])


def test_one_vehicle_tracked_twice_is_no_conflict() -> None:
    assert find_conflicts([straight(1, (0, 0), 0.0, 10), straight(2, (0.5, 0.2), 0.0, 10)], CONFIG) == []


def test_vehicles_that_stand_in_each_other_at_any_time_are_an_error_of_tracking() -> None:
    a = from_speed(1, (0, -40), np.pi / 2, np.r_[np.full(16, 10.0), np.linspace(10, 0, 9), np.zeros(10)])
    b = straight(2, (-40, 0), 0.0, 10, seconds=5.5)
    assert len(find_conflicts([a, b], CONFIG)) == 1
    b.boxes[-1] = a.boxes[len(b) - 1] + [0.5, 0, 0, 0, 0, 0, 0]
    assert find_conflicts([a, b], CONFIG) == []


def test_a_flicker_of_one_instant_is_no_conflict() -> None:
    a, b = straight(1, (0, 0), 0.0, 10, seconds=3), straight(2, (0, 12), 0.0, 10, seconds=3)
    a.velocities_mps[8] = (10, 15)
    assert find_conflicts([a, b], CONFIG) == []


@pytest.mark.parametrize(("option", "value"), [("min_instants", 12), ("min_duration_s", 1.8), ("min_track_s", 2.0)])
def test_how_long_a_conflict_lasts_is_for_the_user_to_say(option: str, value: float) -> None:
    rear_end = [straight(1, (0, 0), 0.0, 15, 2), straight(2, (30, 0), 0.0, 3, 2)]  # 11 instants, 1.6 s, in 1.92 s
    (conflict,) = find_conflicts(rear_end, CONFIG)
    assert conflict.duration_s == pytest.approx(1.6)
    assert find_conflicts(rear_end, CONFIG.model_copy(update={option: value})) == []


def test_how_sure_a_conflict_must_be_is_for_the_user_to_say() -> None:
    # one drives past the other at a distance of which nobody can say whether it is one
    close = [straight(1, (0, 0), 0.0, 15, 2, sd=0.25), straight(2, (30, 2.3), 0.0, 3, 2, sd=0.25)]
    (conflict,) = find_conflicts(close, CONFIG.model_copy(update={"min_probability": 0.05}))
    assert 0.05 <= conflict.probability < 0.8
    assert find_conflicts(close, CONFIG.model_copy(update={"min_probability": 0.9})) == []


def test_what_is_one_direction_and_what_overlaps_is_for_the_user_to_say() -> None:
    side_by_side = [straight(1, (0, 0), 0.0, 15, 1.4), straight(2, (0, 8), -0.25, 15, 1.4)]
    gentle = CONFIG.model_copy(update={"min_deceleration_mps2": 0.0})
    (merging,) = find_conflicts(side_by_side, gentle)
    (crossing,) = find_conflicts(side_by_side, gentle.model_copy(update={"same_direction_deg": 10.0}))
    assert (merging.kind, crossing.kind) == (ConflictType.MERGING, ConflictType.CROSSING)
    a = from_speed(1, (0, -40), np.pi / 2, np.r_[np.full(16, 10.0), np.linspace(10, 0, 9), np.zeros(10)], sd=0.02)
    b = straight(2, (-40, 0), 0.0, 10, seconds=5.5, sd=0.02)
    b.boxes[-1] = a.boxes[len(b) - 1] + [1.6, 0, 0, 0, 0, 0, 0]  # a little
    assert len(find_conflicts([a, b], CONFIG.model_copy(update={"max_overlap_iou": 0.9}))) == 1
    assert find_conflicts([a, b], CONFIG) == []


def test_deceleration_to_avoid() -> None:
    # 10 m/s on a standing vehicle 20 m ahead: v² / (2 d) = 2.5 m/s²
    assert deceleration_to_avoid(2.0, [10.0, 0.0], [0.0, 0.0]) == pytest.approx(2.5)
    assert deceleration_to_avoid(np.inf, [10.0, 0.0], [0.0, 0.0]) == 0


def test_the_stage_writes_conflicts_as_json(tmp_path: Path) -> None:
    folders = StageFolders(tmp_path)
    folders.give(TRACKS, [straight(4, (0, -20), np.pi / 2, 10, seconds=5), straight(2, (-31, 0), 0.0, 10, seconds=5)])
    folders.give(FITS, [])
    folders.give(
        SPLIT,
        Split(times_ns={"train": (0,), "val": (), "test": ()}, left_out_tracks={"train": (), "val": (), "test": ()}),
    )
    summary = stage.run(folders.context("safety", Site.model_construct(name="s", cameras=())), CONFIG)
    written = json.loads(folders.place(CONFLICTS).read_text())
    assert summary["conflicts"] == len(written["conflicts"]) == 1
    assert written["conflicts"][0]["type"] == "crossing"
    assert summary["by_road_users"] == {"car and car": 1}
    assert written["conflicts"][0]["pet_s"] == pytest.approx(0.5, abs=0.01)
    assert written["thresholds"]["pet_s"] == 1.5


def test_no_tracks_no_conflicts() -> None:
    assert find_conflicts([], CONFIG) == []


def of_class(track: Track, road_user: RoadUserClass) -> Track:
    """The same way, gone by somebody of another class and its usual size."""
    boxes = track.boxes.copy()
    boxes[:, 3:6] = road_user.traits.size.size_m
    boxes[:, 2] = boxes[:, 5] / 2
    return replace(track, vehicle_class=road_user, boxes=boxes)


@pytest.mark.parametrize("crosses", [RoadUserClass.PEDESTRIAN, RoadUserClass.BICYCLE, RoadUserClass.MOTORCYCLE])
def test_who_is_hit_from_the_side_is_in_conflict_with_the_car(crosses: RoadUserClass) -> None:
    speed = 1.4 if crosses is RoadUserClass.PEDESTRIAN else 4.0
    # from 24 m away the car brakes as hard as it can, and stops 3 m before the other's path
    speeds = np.clip(10 - 6.0 * (np.arange(50) / RATE_HZ - 1.2), 0, 10)
    car = from_speed(1, (-25.0, 0), 0.0, speeds)
    other = of_class(straight(2, (0, -2.6 * speed), np.pi / 2, speed), crosses)
    (conflict,) = find_conflicts([car, other], CONFIG)
    assert conflict.classes == (RoadUserClass.CAR, crosses)
    assert conflict.kind is ConflictType.CROSSING
    assert 0.5 < conflict.ttc_s < 1.5


def test_a_car_that_passes_after_somebody_crossed_encroaches() -> None:
    walker = of_class(straight(2, (0, -4), np.pi / 2, 1.4), RoadUserClass.PEDESTRIAN)
    car = straight(1, (-50, 0), 0.0, 10)
    (conflict,) = find_conflicts([car, walker], CONFIG)
    # who walks is 0.39 m past the lane's edge at y = 1 after (4 + 1 + 0.39) / 1.4 s; the car's front is at x = −0.33
    # after (50 − 2 − 0.33) / 10 s
    assert conflict.pet_s == pytest.approx(4.767 - 3.85, abs=0.02)
    assert conflict.classes == (RoadUserClass.CAR, RoadUserClass.PEDESTRIAN)


def test_two_who_walk_are_never_in_conflict() -> None:
    ways = [straight(1, (-6, 0), 0.0, 1.5), straight(2, (0, -6), np.pi / 2, 1.5)]
    assert find_conflicts([of_class(way, RoadUserClass.PEDESTRIAN) for way in ways], CONFIG) == []
    cyclist = of_class(straight(1, (-9, 0), 0.0, 3.0), RoadUserClass.BICYCLE)
    walker = of_class(straight(2, (0, -6), np.pi / 2, 1.5), RoadUserClass.PEDESTRIAN)
    (passing,) = find_conflicts([cyclist, walker], CONFIG)
    assert passing.classes == (RoadUserClass.BICYCLE, RoadUserClass.PEDESTRIAN)
    assert passing.pet_s < 1.0


def test_somebody_in_a_vehicle_is_no_conflict() -> None:
    bus = of_class(straight(1, (-30, 0), 0.0, 6), RoadUserClass.BUS)
    seat = of_class(straight(2, (-28, 0.4), 0.0, 6.2), RoadUserClass.PEDESTRIAN)
    assert find_conflicts([bus, seat], SafetyConfig(min_deceleration_mps2=0.0)) == []
