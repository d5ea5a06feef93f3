from __future__ import annotations

import numpy as np

from wibam_core.association.grouping import group


def grouped(instants: list[list[tuple[int, int]]], cameras: list[int]) -> list[int]:
    """Of instants as (tracklet, cluster) of each ray."""
    tracklets = [np.array([t for t, _ in rays], np.int64) for rays in instants]
    clusters = [np.array([c for _, c in rays], np.int64) for rays in instants]
    return group(tracklets, clusters, np.array(cameras)).tolist()


def test_tracklets_that_mostly_meet_are_one_vehicle() -> None:
    apart, together = [(0, 0), (1, 1)], [(0, 0), (1, 0)]
    assert grouped([together, together, apart], [0, 1]) == [0, 0]
    assert grouped([apart, together, apart], [0, 1]) == [0, 1]


def test_only_instants_at_which_both_are_there_count() -> None:
    assert grouped([[(0, 0)]] * 20 + [[(0, 0), (1, 0)]] * 2 + [[(1, 0)]] * 20, [0, 1]) == [0, 0]


def test_a_vehicle_goes_on_where_another_camera_saw_it_all_the_time() -> None:
    """The first camera loses it and finds it again, the second does not."""
    assert grouped([[(0, 0), (1, 0)]] * 5 + [[(1, 0)]] * 5 + [[(2, 0), (1, 0)]] * 5, [0, 1, 0]) == [0, 0, 0]


def test_a_camera_sees_a_vehicle_once() -> None:
    """Both of the first camera's meet the second's, one at a time; they were seen side by side before."""
    side_by_side = [[(0, 0), (1, 1)]]
    by_turns = [[(0, 0), (1, 1), (2, 0)]] * 6 + [[(0, 0), (1, 1), (2, 1)]] * 6
    assert grouped(side_by_side + by_turns, [0, 0, 1])[:2] == [0, 1]


def test_those_that_met_most_often_come_first() -> None:
    rays = [[(0, 0), (1, 1), (2, 0)]] * 8 + [[(1, 1), (2, 1)]] * 8
    assert grouped(rays, [0, 0, 1]) == [0, 1, 0]
    rays += [[(1, 1), (2, 1)]] * 4  # now the second met it more often
    assert grouped(rays, [0, 0, 1]) == [0, 1, 1]


def test_tracklets_out_of_range_are_each_by_itself() -> None:
    assert grouped([[(0, 0), (2, 0)]], [0, 1, 1]) == [0, 1, 0]
