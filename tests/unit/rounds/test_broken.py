"""Vehicles whose track breaks where the training part ends: their second track must not judge."""

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
