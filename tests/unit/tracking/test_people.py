"""People on foot and on two wheels, on given boxes: their own models of motion, and never one with a vehicle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from wibam_core.config import TrackConfig
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Track, Vehicles3D
from wibam_core.tracking.tracker import Tracker

PERIOD_NS = 160_000_000
#: Place (m) and yaw (rad) at a time in s.
Path = Callable[[float], tuple[float, float, float]]
CAR, BICYCLE, PEDESTRIAN = RoadUserClass.CAR, RoadUserClass.BICYCLE, RoadUserClass.PEDESTRIAN


def there_and_back(seconds: float, speed: float = 1.4) -> Path:
    """Walks along X, turns on the spot, walks back."""
    return lambda t: (speed * (seconds / 2 - abs(t - seconds / 2)), 2.0, 0.0 if t < seconds / 2 else np.pi)


def along(speed: float, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Path:
    return lambda t: (x + speed * t * np.cos(yaw), y + speed * t * np.sin(yaw), yaw)


def follow(
    road_users: list[tuple[RoadUserClass, Path]],
    seconds: float,
    *,
    noise_m: float = 0.2,
    wrong_class: dict[RoadUserClass, tuple[float, RoadUserClass]] | None = None,
    recall: float = 0.9,
    seed: int = 0,
) -> list[Track]:
    """Three cameras' boxes of road users of usual size; the yaw is seen up to half a turn."""
    rng = np.random.default_rng(seed)
    tracker = Tracker(TrackConfig())
    for time_ns in range(0, int(seconds * 1e9), PERIOD_NS):
        detections = []
        for camera in range(3):
            boxes, classes = [], []
            for road_user, path in road_users:
                if rng.random() > recall:
                    continue
                share, taken_for = (wrong_class or {}).get(road_user, (0.0, road_user))
                kind = taken_for if rng.random() < share else road_user
                size = np.array(road_user.traits.size.size_m) * np.exp(rng.normal(size=3) * 0.06)
                x, y, yaw = path(time_ns * 1e-9)
                place = np.array([x, y]) + rng.normal(size=2) * noise_m
                yaw += rng.normal() * 0.3 + rng.choice([0.0, np.pi])
                boxes.append([*place, size[2] / 2, *size, normalise_angle(yaw)])
                classes.append(kind.number)
            detections.append(
                Vehicles3D.of(
                    time_ns,
                    np.array(boxes).reshape(-1, 7),
                    np.array(classes, dtype=np.int64),
                    scores=rng.uniform(0.4, 1, len(boxes)),
                    camera_id=str(camera),
                )
            )
        tracker.step(time_ns, detections)
    return tracker.tracks()


def test_the_stated_standard_deviations_of_walkers_hold_errors_that_last() -> None:
    """All cameras together err by 0.3 m for about a second, beside what each errs by itself."""
    rng, scaled = np.random.default_rng(4), []
    for seed in range(6):
        wrong = rng.normal(size=(12, 2)) * 0.3

        def seen(t: float, wrong: np.ndarray = wrong) -> tuple[float, float, float]:
            off = [np.interp(t, np.arange(12), wrong[:, axis]) for axis in (0, 1)]
            return 1.4 * t + off[0], off[1], 0.0

        (track,) = follow([(PEDESTRIAN, seen)], 10.0, seed=seed)
        truth = np.stack([1.4 * track.times_ns * 1e-9, 0.0 * track.times_ns], axis=1)
        scaled.append((track.boxes[:, :2] - truth) / track.sd[:, :2])
    assert 0.5 < np.sqrt(np.square(np.concatenate(scaled)).mean()) < 1.0


def test_somebody_who_turns_round_on_the_spot_keeps_their_track_and_looks_ahead() -> None:
    path = there_and_back(8.0)
    (track,) = follow([(PEDESTRIAN, path)], 8.0)
    assert track.vehicle_class is PEDESTRIAN
    truth = np.array([path(t * 1e-9) for t in track.times_ns])
    off = np.linalg.norm(track.boxes[:, :2] - truth[:, :2], axis=1)
    assert np.median(off) < 0.12 and off.max() < 0.5  # most at the turn, which takes no time at all
    walking = np.abs(track.times_ns * 1e-9 - 4.0) > 1.0
    assert np.abs(normalise_angle(track.boxes[:, 6] - truth[:, 2]))[walking].max() < np.radians(35)
    speed = np.hypot(*track.velocities_mps.T)
    assert speed[walking].mean() == pytest.approx(1.4, abs=0.15)


def test_two_who_meet_go_on_as_they_were() -> None:
    tracks = follow([(PEDESTRIAN, along(1.3, x=-5.0)), (PEDESTRIAN, along(1.3, x=5.0, y=0.9, yaw=np.pi))], 8.0)
    assert len(tracks) == 2
    courses = sorted(float(track.velocities_mps[:, 0].mean()) for track in tracks)
    assert courses == [pytest.approx(-1.3, abs=0.15), pytest.approx(1.3, abs=0.15)]


def test_somebody_beside_a_car_is_not_fused_with_it() -> None:
    tracks = follow([(CAR, along(0.0)), (PEDESTRIAN, along(1.3, x=-4.0, y=1.5))], 6.0)
    assert sorted(track.vehicle_class.value for track in tracks) == ["car", "pedestrian"]
    walker = next(track for track in tracks if track.vehicle_class is PEDESTRIAN)
    assert np.abs(walker.boxes[:, 1] - 1.5).max() < 0.4


def test_a_cyclist_rides_a_curve_that_no_car_could() -> None:
    radius, speed = 2.5, 3.0

    def curve(t: float) -> tuple[float, float, float]:
        angle = speed * t / radius
        return radius * np.sin(angle), radius * (1 - np.cos(angle)), angle

    (track,) = follow([(BICYCLE, curve)], 8.0)
    assert track.vehicle_class is BICYCLE
    truth = np.array([curve(t * 1e-9) for t in track.times_ns])
    assert np.median(np.linalg.norm(track.boxes[:, :2] - truth[:, :2], axis=1)) < 0.2
    assert np.median(track.yaw_rates_radps) == pytest.approx(speed / radius, rel=0.15)
    assert np.median(np.abs(normalise_angle(track.boxes[:, 6] - truth[:, 2]))) < np.radians(15)


def test_a_rider_taken_for_somebody_on_foot_now_and_then_stays_one_track() -> None:
    tracks = follow([(BICYCLE, along(4.0, x=-14.0))], 7.0, wrong_class={BICYCLE: (0.3, PEDESTRIAN)}, seed=2)
    assert [track.vehicle_class for track in tracks] == [BICYCLE]
    assert len(tracks[0]) > 40
    assert np.median(np.hypot(*tracks[0].velocities_mps.T)) == pytest.approx(4.0, abs=0.3)


def test_what_is_seen_as_a_pedestrian_at_first_becomes_the_cyclist_that_it_is() -> None:
    """The states of the two models of motion mean other things: the filter starts over with all that was seen."""
    tracker = Tracker(TrackConfig())
    for step in range(30):
        kind = PEDESTRIAN if step < 4 else BICYCLE
        box = np.array([[0.16 * 5.0 * step, 0.0, 0.87, *BICYCLE.traits.size.size_m, 0.0]])
        tracker.step(step * PERIOD_NS, [Vehicles3D.of(step * PERIOD_NS, box, np.array([kind.number]), camera_id="a")])
    (track,) = tracker.tracks()
    assert track.vehicle_class is BICYCLE
    assert track.velocities_mps[:, 0] == pytest.approx(5.0, abs=0.4)
