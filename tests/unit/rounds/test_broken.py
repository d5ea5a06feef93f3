"""Vehicles whose track breaks where the training part ends: their second track must not judge."""

import numpy as np
import pytest

from wibam_core.config import AssociateConfig
from wibam_core.road_users import RoadUserClass
from wibam_core.rounds.broken import broken_tracks
from wibam_core.scene import AnnotatedInstant, MultiViewVehicle

#: The training part ends after 4 of 10 s.
END_NS = 4_000_000_000
#: A track: its first and last time, s, where it is at first, m, and its velocity, m/s.
Way = tuple[float, float, tuple[float, float], tuple[float, float]]
#: It drives along X at 10 m/s until it is lost at x = 35 m.
LOST: Way = (0.0, 3.5, (0.0, 0.0), (10.0, 0.0))


def instants(tracks: dict[int, Way]) -> list[AnnotatedInstant]:
    """Ten seconds at 5 Hz."""
    found = []
    for k in range(51):
        time_s = k / 5
        vehicles = tuple(
            MultiViewVehicle(
                track, track, RoadUserClass.CAR, x + u * (time_s - first), y + v * (time_s - first), {"a": 0, "b": 0}
            )
            for track, (first, last, (x, y), (u, v)) in tracks.items()
            if first <= time_s <= last
        )
        found.append(AnnotatedInstant(round(time_s * 1e9), {}, vehicles))
    return found


@pytest.mark.parametrize(
    ("found_again", "same"),
    [
        ((5.0, 8.0, (50.0, 0.0), (10.0, 0.0)), True),  # where it is after 1.5 s
        ((5.0, 8.0, (45.0, 8.0), (6.0, 6.0)), True),  # after it turned
        ((5.0, 8.0, (38.0, 0.0), (0.0, 0.0)), True),  # after it stopped
        ((5.0, 8.0, (25.0, 0.0), (10.0, 0.0)), False),  # one that follows it
        ((5.0, 8.0, (80.0, 0.0), (10.0, 0.0)), False),  # too far ahead
        ((8.0, 9.0, (80.0, 0.0), (10.0, 0.0)), False),  # longer after than moving vehicles are hidden
    ],
)
def test_a_track_that_may_be_the_rest_of_one_that_taught_does_not_judge(found_again: Way, same: bool) -> None:
    found = broken_tracks(instants({1: LOST, 2: found_again}), {1}, END_NS, AssociateConfig())
    assert found == ({2} if same else frozenset())


def test_one_that_stands_may_be_hidden_for_longer() -> None:
    stands: Way = (0.0, 3.5, (10.0, 0.0), (0.0, 0.0))
    again: Way = (9.0, 10.0, (11.0, 0.5), (0.0, 0.0))
    config = AssociateConfig()
    assert broken_tracks(instants({1: stands, 2: again}), {1}, END_NS, config) == {2}
    assert not broken_tracks(
        instants({1: stands, 2: again}), {1}, END_NS, config.model_copy(update={"max_hidden_standing_s": 4.0})
    )


def test_only_what_teaches_and_only_what_begins_later_matters() -> None:
    again: Way = (5.0, 8.0, (50.0, 0.0), (10.0, 0.0))
    earlier: Way = (3.0, 8.0, (30.0, 0.0), (10.0, 0.0))
    assert not broken_tracks(instants({1: LOST, 2: again}), frozenset(), END_NS, AssociateConfig())
    assert not broken_tracks(instants({1: LOST, 2: earlier}), {1}, END_NS, AssociateConfig())


def may_be_one(ended: list[tuple[float, float, float]], begun: list[tuple[float, float, float]]) -> bool:
    """The rule for two tracks of times, s, and places, m; with the usual settings."""

    def velocity(rows: list[tuple[float, float, float]]) -> np.ndarray:
        (first_s, *start), (last_s, *end) = rows[0], rows[-1]
        return (np.array(end) - start) / (last_s - first_s) if last_s > first_s else np.zeros(2)

    before = velocity([row for row in ended if ended[-1][0] - row[0] <= 1.0])
    after = velocity([row for row in begun if row[0] - begun[0][0] <= 1.0])
    hidden_s = abs(begun[0][0] - ended[-1][0])
    way = np.array(begun[0][1:]) - ended[-1][1:]
    speed = max(np.hypot(*before), np.hypot(*after))
    if hidden_s > (45.0 if speed < 1.0 else 3.0):
        return False
    ahead_m = way @ before / max(np.hypot(*before), 1.0)
    return bool(np.hypot(*way) <= 4.0 + (speed * hidden_s if speed >= 1.0 else 0.0) and ahead_m >= -4.0)


@pytest.mark.parametrize("seed", range(8))
def test_every_pair_of_tracks_counts(seed: int) -> None:
    random = np.random.default_rng(seed)
    tracks: dict[int, Way] = {}
    for track in range(80):
        first, lasts = random.uniform(0, 10), random.exponential(3)
        x, y, u, v = (*random.uniform(-20, 20, 2), *(random.normal(0, 5, 2) * random.integers(0, 2)))
        tracks[track] = (first, first + lasts, (float(x), float(y)), (float(u), float(v)))
    seen = instants(tracks)
    rows: dict[int, list[tuple[float, float, float]]] = {}
    for instant in seen:
        for vehicle in instant.vehicles:
            rows.setdefault(vehicle.track_id, []).append((instant.time_ns * 1e-9, vehicle.x_m, vehicle.y_m))
    teaching = set(range(0, 80, 2))
    expected = {
        track
        for track, own in rows.items()
        if track not in teaching and own[0][0] > END_NS * 1e-9
        if any(may_be_one(rows[other], own) for other in teaching & rows.keys())
    }
    assert expected
    assert broken_tracks(seen, teaching, END_NS, AssociateConfig()) == expected
