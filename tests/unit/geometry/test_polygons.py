"""Points in polygons whose answer is plain."""

from __future__ import annotations

import numpy as np

from wibam_core.geometry.polygons import inside_any


def test_a_notch_is_outside_and_two_polygons_are_one_or_the_other() -> None:
    notched = np.array([[0, 0], [4, 0], [4, 4], [2, 1], [0, 4]], float)
    square = np.array([[10, 0], [11, 0], [11, 1], [10, 1]], float)
    points = np.array([[1, 1], [2, 2], [2, 0.5], [10.5, 0.5], [7, 0.5], [-1, 2]])
    assert inside_any(points, [notched, square]).tolist() == [True, False, True, True, False, False]
    assert inside_any(points, [notched[::-1], square[::-1]]).tolist() == [True, False, True, True, False, False]


def test_nothing_is_inside_of_nothing() -> None:
    assert inside_any(np.zeros((2, 2)), []).tolist() == [False, False]
    assert inside_any(np.empty((0, 2)), [np.array([[0, 0], [1, 0], [0, 1]], float)]).tolist() == []
