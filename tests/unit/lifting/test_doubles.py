from __future__ import annotations

import numpy as np

from wibam_core.lifting.doubles import doubled
from wibam_core.road_users import CLASSES


def left_out(*fits: tuple[float, float, int, int, float], classes: list[int] | None = None) -> list[bool]:
    """Whether fits are left out: each is x, length, instant, track and score, all along the X axis."""
    x, length, instants, tracks, scores = np.array(fits).T
    ones = np.ones(len(x))
    boxes = np.stack([x, 0 * ones, 0.75 * ones, length, 1.8 * ones, 1.5 * ones, 0 * ones], axis=1)
    of = np.zeros(len(x), dtype=np.int64) if classes is None else np.array(classes)
    return doubled(boxes, of, instants.astype(int), tracks.astype(int), scores).tolist()


def test_the_front_of_a_long_vehicle_is_left_out_beside_it() -> None:
    assert left_out((0.0, 10.0, 0, 5, 0.8), (3.0, 4.0, 0, 2, 0.6)) == [False, True]


def test_who_was_seen_for_longer_stays_even_where_its_score_is_lower() -> None:
    long_track = [(0.0, 10.0, instant, 1, 0.5) for instant in range(4)]
    assert left_out(*long_track, (3.0, 4.0, 2, 2, 0.9)) == [False] * 4 + [True]


def test_neighbours_and_other_instants_are_no_doubles() -> None:
    assert left_out((0.0, 4.0, 0, 1, 0.8), (3.5, 4.0, 0, 2, 0.6)) == [False, False], "bumper to bumper, 0.5 m of error"
    assert left_out((0.0, 4.0, 0, 1, 0.8), (0.5, 4.0, 1, 2, 0.6)) == [False, False]


def test_who_stands_in_one_that_is_left_out_stays() -> None:
    assert left_out((0.0, 6.0, 0, 1, 0.9), (3.0, 6.0, 0, 2, 0.6), (6.0, 6.0, 0, 3, 0.3)) == [False, True, False]


def test_who_walks_beside_somebody_is_never_left_out() -> None:
    walking = CLASSES.index("pedestrian")
    assert left_out((0.0, 1.0, 0, 1, 0.8), (0.1, 1.0, 0, 2, 0.6), classes=[walking, 0]) == [False, False]


def test_nothing_is_left_out_of_nothing() -> None:
    assert doubled(np.empty((0, 7)), *[np.empty(0, dtype=np.int64)] * 3, np.empty(0)).shape == (0,)
