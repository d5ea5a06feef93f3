from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from wibam_core.geometry.boxes2d import (
    areas_px2,
    clipped_to_image,
    distinct,
    image_iou,
    non_maximum_suppression,
)

corners = hnp.arrays(np.float64, (12, 2), elements=st.integers(0, 60))
sides = hnp.arrays(np.float64, (12, 2), elements=st.integers(1, 30))


def test_iou_of_known_boxes() -> None:
    a = np.array([[0.0, 0.0, 2.0, 2.0]])
    b = np.array([[1.0, 0.0, 3.0, 2.0], [0.0, 0.0, 2.0, 2.0], [5.0, 5.0, 6.0, 6.0], [1.0, 1.0, 1.0, 1.0]])
    assert image_iou(a, b)[0] == pytest.approx([1 / 3, 1.0, 0.0, 0.0])
    assert image_iou(np.zeros((0, 4)), b).shape == (0, 4)


@given(corners, sides, hnp.arrays(np.float64, 12, elements=st.integers(0, 5)), st.sampled_from([0.2, 0.5, 0.8]))
def test_law_suppression_is_what_one_box_after_another_gives(
    corner: np.ndarray, side: np.ndarray, score: np.ndarray, max_iou: float
) -> None:
    boxes = np.concatenate([corner, corner + side], axis=1)
    kept: list[int] = []
    for i in sorted(range(12), key=lambda k: (-score[k], k)):
        if all(image_iou(boxes[[i]], boxes[[k]])[0, 0] <= max_iou for k in kept):
            kept.append(i)
    assert non_maximum_suppression(boxes, score, max_iou).tolist() == kept


def test_boxes_that_are_not_anywhere_overlap_nothing() -> None:
    assert image_iou([[np.nan] * 4, [0, 0, 2, 2]], [[0, 0, 2, 2], [np.nan] * 4]).tolist() == [[0, 0], [1, 0]]


def test_of_boxes_that_come_best_first_the_later_of_two_that_overlap_goes() -> None:
    boxes = np.array([[0.0, 0, 10, 10], [0, 0, 10, 9], [0, 0, 10, 4], [20, 0, 30, 10]])
    assert distinct(boxes, 0.7).tolist() == [0, 2, 3]
    assert distinct(boxes[:0], 0.7).tolist() == []


def test_convention_an_image_begins_half_a_pixel_before_its_first_centre() -> None:
    boxes = np.array([[-9.0, 5, 700, 20], [-9, -9, -3, -2]])
    clipped = clipped_to_image(boxes, 640, 360)
    assert clipped.tolist() == [[-0.5, 5, 639.5, 20], [-0.5, -0.5, -0.5, -0.5]]
    assert areas_px2(clipped).tolist() == [640 * 15, 0]
