from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from wibam_core.config import TrackConfig
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Track, Vehicles3D
from wibam_core.tracking.hota import hota
from wibam_core.tracking.tracker import Tracker

PERIOD_NS = 160_000_000
Path = Callable[[float], tuple[float, float, float]]


def drive(speed: float, y: float = 0.0, x: float = -30.0) -> Path:
    return lambda t: (x + speed * t, y, 0.0)


def circle(speed: float, radius: float) -> Path:
    return lambda t: (
        radius * np.sin(speed * t / radius),
        radius * (1 - np.cos(speed * t / radius)),
        speed * t / radius,
    )


def park(x: float, y: float, yaw: float) -> Path:
    return lambda t: (x, y, yaw)


def truth_of(paths: list[Path], seconds: float, size: tuple[float, float, float] = (4.5, 1.8, 1.5)) -> list[Track]:
    times = np.arange(0, int(seconds * 1e9), PERIOD_NS)
    tracks = []
    for number, path in enumerate(paths):
        places = np.array([path(t * 1e-9) for t in times])
        boxes = np.column_stack(
            [places[:, :2], np.full(len(times), size[2] / 2), np.tile(size, (len(times), 1)), places[:, 2]]
        )
        boxes[:, 6] = normalise_angle(boxes[:, 6])
        n = len(times)
        tracks.append(
            Track(number, RoadUserClass.CAR, times, boxes, np.full((n, 7), np.nan), np.zeros((n, 2)), np.zeros(n))
        )
    return tracks


def follow(
    paths: list[Path],
    seconds: float,
    *,
    cameras: int = 3,
    noise_m: float = 0.4,
    yaw_noise: float = 0.15,
    recall: float = 0.9,
    flips: float = 0.0,
    false_rate: float = 0.0,
    late_s: dict[int, float] | None = None,
    seed: int = 0,
    config: TrackConfig | None = None,
) -> list[Track]:
    rng = np.random.default_rng(seed)
    tracker = Tracker(config or TrackConfig())
    late_s = late_s or {}
    for time in range(0, int(seconds * 1e9), PERIOD_NS):
        detections, exposed = [], {}
        for camera in range(cameras):
            frame_time = time + int(late_s.get(camera, 0.0) * 1e9)
            rows = []
            for path in paths:
                if rng.random() > recall:
                    continue
                x, y, yaw = path(frame_time * 1e-9)
                yaw += rng.normal() * yaw_noise + (np.pi if rng.random() < flips else 0)
                size = np.array([4.5, 1.8, 1.5]) * np.exp(rng.normal(size=3) * 0.06)
                rows.append(
                    [*(np.array([x, y]) + rng.normal(size=2) * noise_m), size[2] / 2, *size, normalise_angle(yaw)]
                )
            for _ in range(rng.poisson(false_rate)):
                rows.append([*rng.uniform(-30, 30, 2), 0.75, 4.5, 1.8, 1.5, rng.uniform(-3, 3)])
            boxes = np.array(rows).reshape(-1, 7)
            exposed[str(camera)] = frame_time
            detections.append(Vehicles3D.of(time, boxes, scores=rng.uniform(0.4, 1, len(boxes)), camera_id=str(camera)))
        tracker.step(time, detections, exposed)
    return tracker.tracks()


def errors(track: Track, path: Path) -> tuple[np.ndarray, np.ndarray]:
    want = np.array([path(t * 1e-9) for t in track.times_ns])
    place = np.linalg.norm(track.boxes[:, :2] - want[:, :2], axis=1)
    return place, np.degrees(np.abs(normalise_angle(track.boxes[:, 6] - want[:, 2])))


def test_without_noise_a_turn_is_followed_exactly() -> None:
    path = circle(6.0, 9.0)
    (track,) = follow([path], 6, noise_m=0.0, yaw_noise=0.0, recall=1.0)
    place, yaw = errors(track, path)
    # the centre of a circling vehicle's heading, by the bicycle model, leads the tangent a little
    assert place.max() < 0.35
    assert yaw[5:].max() < 9
    assert track.yaw_rates_radps[10:-5] == pytest.approx(6 / 9, rel=0.1)
    assert np.hypot(*track.velocities_mps[10:-5].T) == pytest.approx(6, rel=0.05)


@pytest.mark.parametrize("path", [drive(12.0), circle(7.0, 12.0), drive(3.0)])
def test_smoothing_beats_the_noise_and_knows_how_sure_it_is(path: Path) -> None:
    (track,) = follow([path], 8, noise_m=0.5)
    place, yaw = errors(track, path)
    assert np.sqrt(np.mean(place**2)) < 0.5  # one detection alone: 0.7
    assert yaw.mean() < 6
    want = np.array([path(t * 1e-9)[:2] for t in track.times_ns])
    standardised = (track.boxes[:, :2] - want) / track.sd[:, :2]
    # errors of one picture and the next have nothing in common here; a real camera's have, and that is reckoned with
    assert 0.25 < np.sqrt(np.mean(standardised**2)) < 2.0


def test_one_track_per_vehicle_in_noise_misses_and_false_boxes() -> None:
    paths = [drive(10.0), drive(8.0, 3.5), drive(-9.0, 7.0, 35.0), circle(6.0, 15.0), park(20, -12, 1.0)]
    paths[2] = lambda t: (35.0 - 9.0 * t, 7.0, np.pi)
    tracks = follow(paths, 6, false_rate=0.05, recall=0.8)
    score = hota(truth_of(paths, 6), tracks)
    assert len(tracks) == len(paths)
    assert score.ass_a > 0.8
    assert score.hota > 0.6


def test_flipped_headings_are_set_right_by_motion() -> None:
    (track,) = follow([drive(8.0)], 5, flips=0.6)
    _, yaw = errors(track, drive(8.0))
    assert yaw.max() < 20
    assert (track.velocities_mps[3:, 0] > 0).all()


def test_a_parked_vehicle_does_not_spin_and_heads_where_most_views_say() -> None:
    (track,) = follow([park(3, 4, 2.0)], 8, flips=0.25, yaw_noise=0.25)
    turns = np.abs(normalise_angle(np.diff(track.boxes[:, 6])))
    assert turns.max() < 0.1
    assert np.abs(normalise_angle(track.boxes[:, 6] - 2.0)).max() < 0.3
    assert np.hypot(*track.velocities_mps.T).max() < 1.0


def test_a_queue_is_not_mixed_up() -> None:
    paths = [park(6.5 * k, 0, 0.0) for k in range(5)]
    tracks = follow(paths, 5, noise_m=0.6)
    assert len(tracks) == 5
    assert hota(truth_of(paths, 5), tracks).ass_a > 0.8


def test_each_frame_counts_at_its_own_time() -> None:
    path = drive(15.0)
    late = {0: 0.04, 1: 0.04, 2: 0.04}
    (track,) = follow([path], 5, noise_m=0.05, yaw_noise=0.02, late_s=late, recall=1.0)
    place, _ = errors(track, path)
    assert place[3:].mean() < 0.15  # uncorrected: 0.6 m


def test_gaps_are_bridged_and_longer_ones_end_a_track() -> None:
    tracker = Tracker(TrackConfig(max_coast_s=1.0))
    for k in range(40):
        seen = not 10 <= k < 14 and not 22 <= k < 32
        boxes = np.array([[0.16 * 5 * k, 0, 0.75, 4.5, 1.8, 1.5, 0.0]]) if seen else np.empty((0, 7))
        tracker.step(k * PERIOD_NS, [Vehicles3D.of(k * PERIOD_NS, boxes, camera_id="a")])
    first, second = tracker.tracks()
    assert first.times_ns.tolist() == [k * PERIOD_NS for k in range(22)]
    assert second.times_ns.tolist() == [k * PERIOD_NS for k in range(32, 40)]
    assert first.boxes[12, 0] == pytest.approx(0.16 * 5 * 12, abs=0.1)
    assert first.sd[12, 0] > first.sd[8, 0]


def test_rarely_seen_vehicles_are_dropped_and_nothing_seen_is_no_track() -> None:
    assert follow([drive(5.0)], 0.5, recall=1.0, config=TrackConfig(min_hits=5)) == []
    assert len(follow([drive(5.0)], 0.5, recall=1.0, config=TrackConfig(min_hits=4))) == 1
    assert follow([], 2) == []


def test_one_camera_is_enough_and_runs_repeat() -> None:
    one = follow([drive(10.0)], 5, cameras=1)
    again = follow([drive(10.0)], 5, cameras=1)
    assert len(one) == 1
    np.testing.assert_array_equal(one[0].boxes, again[0].boxes)


def test_one_size_over_the_track_on_the_ground() -> None:
    (track,) = follow([drive(6.0)], 8)
    assert np.ptp(track.boxes[:, 3:6], axis=0) == pytest.approx(0)
    assert track.boxes[0, 3:6] == pytest.approx([4.5, 1.8, 1.5], rel=0.04)
    np.testing.assert_allclose(track.boxes[:, 2], track.boxes[:, 5] / 2)


@pytest.mark.parametrize(("max_place_sd_m", "min_seen_share", "tracks"), [(3.0, 0.3, 0), (5.0, 0.15, 1)])
def test_detections_with_an_unknown_place_and_chains_of_false_boxes_make_no_track_unless_options_say_so(
    max_place_sd_m: float, min_seen_share: float, tracks: int
) -> None:
    config = TrackConfig(max_place_sd_m=max_place_sd_m, min_seen_share=min_seen_share)
    box = np.array([[0.0, 0, 0.75, 4.5, 1.8, 1.5, 0.0]])
    uncertain, rare = Tracker(config), Tracker(config)
    for k in range(40):
        time = k * PERIOD_NS
        sd = np.full((1, 7), 4.0)
        uncertain.step(time, [Vehicles3D.of(time, box, sd=sd, camera_id="a")])
        rare.step(time, [Vehicles3D.of(time, box if k % 5 == 0 else box[:0], camera_id="a")])
    assert len(uncertain.tracks()) == len(rare.tracks()) == tracks


def test_a_second_box_of_a_tracked_vehicle_begins_no_track() -> None:
    """Two cameras disagree by more than what is averaged; their boxes overlap by a third to a half."""
    tracker = Tracker(TrackConfig(fusion_radius_m=1.0))
    for number in range(12):
        x_m = 1.6 * number
        boxes = [np.array([[x_m + off_m, 0.0, 0.75, 4.5, 1.8, 1.5, 0.0]]) for off_m in (0.0, 1.9)]
        seen = [Vehicles3D.of(0, box, scores=np.array([0.9]), camera_id=str(k)) for k, box in enumerate(boxes)]
        tracker.step(number * PERIOD_NS, seen)
    (track,) = tracker.tracks()
    assert len(track.times_ns) == 12


def test_who_brakes_hard_is_seen_to_brake_when_it_does() -> None:
    # 9 m/s until second 4, then a stop at 7 m/s²
    def path(t: float) -> tuple[float, float, float]:
        braking = min(max(t - 4.0, 0.0), 9.0 / 7.0)
        return (9.0 * min(t, 4.0) + 9.0 * braking - 3.5 * braking**2 - 36.0, 0.0, 0.0)

    (track,) = follow([path], 8, noise_m=0.15, recall=1.0)
    speeds = np.hypot(*track.velocities_mps.T)
    since_s = np.clip(track.times_ns * 1e-9 - 4.0, 0.0, 9.0 / 7.0)
    around = np.abs(track.times_ns * 1e-9 - 4.5) < 1.5
    # smoothed as one who drives on, it would be off by 0.83 m/s, and have 7.9 m/s before it brakes
    assert np.sqrt(np.mean((speeds - (9.0 - 7.0 * since_s))[around] ** 2)) < 0.65
    assert speeds[np.searchsorted(track.times_ns, int(3.8e9))] > 8.1


def stopping(t: float) -> tuple[float, float, float]:
    """8 m/s, then 2 m/s² to a stop in the origin at second 6, and the other way round from second 16 on."""
    from_stop_s = 6.0 - t if t < 6.0 else max(t - 16.0, 0.0)
    way_m = from_stop_s**2 if from_stop_s < 4.0 else 8.0 * from_stop_s - 16.0
    return (-way_m if t < 6.0 else way_m, 0.0, 0.0)


def test_who_waits_stands_in_one_place_and_is_placed_better_than_while_it_drives() -> None:
    (track,) = follow([stopping], 22, cameras=1, noise_m=0.6)
    times_s = track.times_ns * 1e-9
    waits = (times_s > 7.0) & (times_s < 15.0)
    assert np.ptp(track.boxes[waits, :2], axis=0).max() < 1e-3
    assert np.hypot(*track.velocities_mps[waits].T).max() < 0.01
    place, _ = errors(track, stopping)
    # the mean of 50 boxes errs by 0.09 m along each axis; the place of one who might go at any time varies by 1 m
    assert place[waits].max() < 0.3
    # and nothing of the way before and after is lost to the stop
    assert np.sqrt(np.mean(place[~waits] ** 2)) < 0.5
    assert np.hypot(*track.velocities_mps[times_s < 5.0].T).min() > 1.0


def test_who_creeps_does_not_stand() -> None:
    path = drive(0.25, x=0.0)
    (track,) = follow([path], 20, cameras=1, noise_m=0.3)
    place, _ = errors(track, path)
    assert place.max() < 0.4
    assert np.ptp(track.boxes[:, 0]) == pytest.approx(5.0, abs=0.4)


def test_who_parked_in_full_view_is_one_track_though_seen_every_five_seconds_later() -> None:
    rng, tracker = np.random.default_rng(0), Tracker(TrackConfig())
    for k in range(600):
        seen = k < 60 or k % 31 == 0
        place = rng.normal(size=2) * 0.15
        boxes = np.array([[*place, 0.75, 4.5, 1.8, 1.5, 0.0]])[: int(seen)]
        tracker.step(k * PERIOD_NS, [Vehicles3D.of(k * PERIOD_NS, boxes, scores=np.full(len(boxes), 0.8))])
    (track,) = tracker.tracks()
    assert track.times_ns[-1] == 589 * PERIOD_NS
