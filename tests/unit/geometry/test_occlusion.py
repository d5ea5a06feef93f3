from __future__ import annotations

import numpy as np
import pytest

from wibam_core.geometry.occlusion import hidden_edges, hidden_share, stands_before

FAR, NEAR, LOW = (100.0, 100, 180, 140), (150.0, 90, 260, 170), (90.0, 136, 260, 170)


def hidden(*boxes: tuple[float, ...], distances_m: tuple[float, ...], least_share: float = 0.2) -> list[list[bool]]:
    both = np.array(boxes)
    found: list[list[bool]] = hidden_edges(both, stands_before(np.array(distances_m)), least_share, both).tolist()
    return found


def test_a_nearer_vehicle_hides_the_edges_inside_its_box() -> None:
    assert hidden(FAR, NEAR, distances_m=(30.0, 20.0)) == [[False, True, True, True], [False] * 4]
    assert not any(hidden(FAR, NEAR, distances_m=(20.0, 30.0))[0])


def test_an_edge_is_hidden_once_enough_of_its_length_is() -> None:
    # the lower 4 of 40 px of the sides are covered, and the whole of the lower edge
    assert hidden(FAR, LOW, distances_m=(30.0, 20.0))[0] == [False, False, False, True]
    assert hidden(FAR, LOW, distances_m=(30.0, 20.0), least_share=0.1)[0] == [True, False, True, True]


def test_boxes_at_unknown_distances_hide_nothing_and_may_be_hidden() -> None:
    assert not any(hidden(FAR, NEAR, distances_m=(30.0, np.inf))[0])
    assert any(hidden(FAR, NEAR, distances_m=(np.inf, 30.0))[0])


def test_one_edge_may_lie_beyond_what_hides_it_by_the_slack() -> None:
    boxes = np.array([(100.0, 100, 200, 140), (90.0, 90, 198.5, 150)])
    before = stands_before(np.array([2.0, 1.0]))
    right = [hidden_edges(boxes, before, 0.2, boxes, slack_px)[0, 2] for slack_px in (1.0, 2.0)]
    assert right == [False, True]


def test_nearly_the_same_distance_tells_no_order() -> None:
    before = stands_before(np.array([10.0, 10.5, 12.0]), margin=1.0)
    assert before.tolist() == [[False] * 3, [False] * 3, [True, True, False]]


def test_hidden_share_is_that_of_the_one_vehicle_that_covers_most() -> None:
    boxes = np.array([(0.0, 0, 10, 10), (5.0, 0, 10, 10), (0.0, 0, 3, 10), (0.0, 0, 9, 10)])
    share = hidden_share(boxes, stands_before(np.array([5.0, 1.0, 2.0, 9.0])))
    assert share == pytest.approx([0.5, 0.0, 0.0, 1.0])
