"""What cameras see of boxes, where it is known without computing it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders import look_at
from wibam_core.geometry.projection import project_boxes
from wibam_core.labelling.seen import seen_by_hand, seen_shares
from wibam_core.scene import CameraRig

RIG = CameraRig({"south": look_at((0.0, -20.0, 4.0)), "north": look_at((0.0, 20.0, 4.0))})
SMALL = [0.0, 0.0, 0.75, 4.0, 1.8, 1.5, 0.0]


def test_a_vehicle_alone_is_seen_whole() -> None:
    found = seen_shares(np.array([SMALL]), RIG)
    assert {name: shares.tolist() for name, shares in found.items()} == {"south": [1.0], "north": [1.0]}


def test_a_wall_before_it_hides_it_from_one_side_alone() -> None:
    wall = [0.0, -6.0, 4.0, 16.0, 0.5, 8.0, 0.0]
    found = seen_shares(np.array([SMALL, wall]), RIG)
    assert found["south"][0] == 0.0
    assert found["north"][0] == 1.0
    assert 0.5 < found["north"][1] < 1.0


def test_what_stands_before_a_camera_hides_a_vehicle_from_it_alone() -> None:
    """The camera looks at the middle of the vehicle: whoever outlines the left half of its picture hides half of it."""
    left = np.array([[-0.5, -0.5], [319.5, -0.5], [319.5, 359.5], [-0.5, 359.5]])
    found = seen_shares(np.array([SMALL]), RIG, {"south": [left]})
    assert found["south"][0] == pytest.approx(0.5, abs=0.02)
    assert found["north"][0] == 1.0
    whole = np.array([[-0.5, -0.5], [639.5, -0.5], [639.5, 359.5], [-0.5, 359.5]])
    assert seen_shares(np.array([SMALL]), RIG, {"south": [whole]})["south"][0] == 0.0


def test_of_one_that_the_border_cuts_the_part_within_is_seen() -> None:
    box = np.array([[-14.2, 0.0, 1.0, 4.0, 1.8, 2.0, 0.0]])
    within, whole = (project_boxes(RIG["south"], box, clamp=clamp)[0] for clamp in (True, False))
    share = (within[2] - within[0]) / (whole[2] - whole[0])
    assert 0.2 < share < 0.8
    assert seen_shares(box, RIG)["south"][0] == pytest.approx(share, abs=0.1)


def test_what_is_behind_a_camera_is_not_seen() -> None:
    assert seen_shares(np.array([[0.0, 30.0, 1.0, 4.0, 2.0, 2.0, 0.0]]), RIG)["north"].tolist() == [0.0]


def test_nothing_is_seen_of_nothing() -> None:
    assert seen_shares(np.empty((0, 7)), RIG)["north"].tolist() == []


def test_what_somebody_says_goes_first() -> None:
    found = seen_by_hand({"south": np.array([1.0, 1.0]), "north": np.array([0.5, 0.5])}, [{}, {"north": 0.2}])
    assert {name: shares.tolist() for name, shares in found.items()} == {"south": [1.0, 1.0], "north": [0.5, 0.2]}
