from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from wibam_core.association.stitching import Sightings, stitch
from wibam_core.config import AssociateConfig

PERIOD_S = 0.1
#: x, y at a time, and when a track of that is seen, s.
Track = tuple[Callable[[float], tuple[float, float]], float, float]


def stitched(*tracks: Track, classes: tuple[int, ...] = (), **options: float) -> list[set[int]]:
    """The ids that the sightings of each track get."""
    instants, given = [], []
    for k in range(round(max(end for _, _, end in tracks) / PERIOD_S) + 1):
        now = k * PERIOD_S
        there = [n for n, (_, begin, end) in enumerate(tracks) if begin - 1e-9 <= now <= end + 1e-9]
        instants.append(
            Sightings(
                np.full(len(there), round(now * 1e9)),
                np.array([tracks[n][0](now) for n in there], float).reshape(-1, 2),
                np.full(len(there), 0.7),
                np.array([classes[n] if classes else 0 for n in there], np.int64),
            )
        )
        given.append(np.array(there, np.int64))
    found = stitch(instants, given, AssociateConfig(**options))
    return [{int(i) for ids, own in zip(found, given, strict=True) for i in ids[own == n]} for n in range(len(tracks))]


def standing(x: float) -> Callable[[float], tuple[float, float]]:
    return lambda _: (x, 0.0)


def driving(speed: float, x: float = 0.0) -> Callable[[float], tuple[float, float]]:
    return lambda t: (x + speed * t, 0.0)


def test_a_standing_vehicle_is_the_same_when_it_is_seen_again() -> None:
    assert stitched((standing(5.0), 0, 3), (standing(5.8), 30, 33)) == [{0}, {0}]


def test_after_too_long_or_elsewhere_it_is_another() -> None:
    assert stitched((standing(5.0), 0, 3), (standing(5.0), 50, 53)) == [{0}, {1}]
    assert stitched((standing(5.0), 0, 3), (standing(11.0), 10, 13)) == [{0}, {1}]


def test_a_moving_vehicle_is_expected_where_its_speed_takes_it() -> None:
    assert stitched((driving(12.0), 0, 2), (driving(12.0), 3, 5)) == [{0}, {0}]
    assert stitched((driving(12.0), 0, 2), (driving(12.0, -12.0), 3, 5)) == [{0}, {1}]
    assert stitched((driving(12.0), 0, 2), (driving(12.0), 6, 8)) == [{0}, {1}]


def test_no_vehicle_stops_at_once() -> None:
    """Where one that stands was hidden by one that passes, the first does not go on as the second."""
    assert stitched((driving(12.0), 0, 2), (standing(25.0), 2.2, 5)) == [{0}, {1}]
    assert stitched((driving(2.0), 0, 2), (standing(4.5), 2.6, 5)) == [{0}, {0}]


def test_a_vehicle_that_brakes_is_the_same_with_another_camera() -> None:
    """What is seen of it for 1.5 s before and after has mean speeds of 4.9 and 1.7 m/s, however short the gap is."""
    braking = lambda t: (7.0 * t - t**2, 0.0)  # noqa: E731 - a way, as those above
    assert stitched((braking, 0, 1.8), (braking, 1.9, 3.5)) == [{0}, {0}]


def test_a_standing_vehicle_may_seem_to_creep_as_much_as_its_place_is_unknown() -> None:
    seeming = lambda t: (5.0 + 1.2 * max(t - 1.5, 0.0), 0.0)  # noqa: E731 - a way, as those above
    assert stitched((seeming, 0, 3), (standing(6.8), 13, 16)) == [{0}, {0}]
    assert stitched((driving(3.0), 0, 3), (standing(9.0), 13, 16)) == [{0}, {1}]


def test_no_vehicle_is_faster_than_the_limit() -> None:
    tracks = ((driving(12.0), 0, 2), (driving(12.0), 3, 5))
    assert stitched(*tracks, max_speed_mps=8.0) == [{0}, {1}]


def test_how_long_a_vehicle_may_be_hidden_is_for_the_site_to_say() -> None:
    queue = ((standing(5.0), 0, 3), (standing(5.0), 23, 26))
    assert stitched(*queue) == [{0}, {0}]
    assert stitched(*queue, max_hidden_standing_s=19.0) == [{0}, {1}]
    passing = ((driving(10.0), 0, 2), (driving(10.0), 4, 6))
    assert stitched(*passing) == [{0}, {0}]
    assert stitched(*passing, max_hidden_moving_s=1.5) == [{0}, {1}]


def test_tracks_seen_at_the_same_time_are_of_different_vehicles() -> None:
    assert stitched((standing(5.0), 0, 3), (standing(5.0), 2, 6)) == [{0}, {1}]


def test_ends_and_beginnings_are_matched_together() -> None:
    """Two wait one behind the other, each a little ahead when it is seen again."""
    queue = [(standing(0.0), 0, 3), (standing(2.5), 0, 3), (standing(1.2), 10, 13), (standing(3.7), 10, 13)]
    assert stitched(*queue) == [{0}, {1}, {0}, {1}]


def test_a_vehicle_may_be_hidden_again_and_again() -> None:
    assert stitched(*((standing(5.0), begin, begin + 2.0) for begin in (0, 10, 20, 30))) == [{0}] * 4


@pytest.mark.parametrize(("other", "same"), [(0, True), (1, False)])
def test_a_vehicle_of_another_class_must_fit_better(other: int, same: bool) -> None:
    found = stitched((standing(5.0), 0, 3), (standing(6.5), 10, 13), classes=(0, other))
    assert (found[0] == found[1]) == same


def test_what_is_seen_once_has_no_track() -> None:
    assert stitched((standing(0.0), 0, 3), (standing(40.0), 1, 1)) == [{0}, {-1}]
    assert stitched((standing(40.0), 1, 1), (standing(0.0), 0, 3)) == [{-1}, {0}]


def test_chains_that_do_not_compete_are_matched_one_by_one() -> None:
    """Two that wait far from each other, both hidden twice; and one that is not seen again."""
    tracks = [(standing(x), begin, begin + 2.0) for begin in (0, 10, 20) for x in (0.0, 50.0)]
    assert stitched(*tracks, (standing(90.0), 0, 2)) == [{0}, {1}, {0}, {1}, {0}, {1}, {2}]


def test_instants_without_vehicles() -> None:
    nothing = Sightings(np.empty(0, np.int64), np.empty((0, 2)), np.empty(0), np.empty(0, np.int64))
    assert [ids.tolist() for ids in stitch([nothing, nothing], [np.empty(0, np.int64)] * 2, AssociateConfig())] == [
        [],
        [],
    ]
    assert stitch([], [], AssociateConfig()) == []
