from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from wibam_core.detection.boxes import non_maximum_suppression, pairwise_iou, select

corners = hnp.arrays(np.float64, (12, 2), elements=st.integers(0, 60))
sides = hnp.arrays(np.float64, (12, 2), elements=st.integers(1, 30))


def test_iou_of_known_boxes() -> None:
    a = np.array([[0.0, 0.0, 2.0, 2.0]])
    b = np.array([[1.0, 0.0, 3.0, 2.0], [0.0, 0.0, 2.0, 2.0], [5.0, 5.0, 6.0, 6.0], [1.0, 1.0, 1.0, 1.0]])
    assert pairwise_iou(a, b)[0] == pytest.approx([1 / 3, 1.0, 0.0, 0.0])
    assert pairwise_iou(np.zeros((0, 4)), b).shape == (0, 4)


@given(corners, sides, hnp.arrays(np.float64, 12, elements=st.integers(0, 5)), st.sampled_from([0.2, 0.5, 0.8]))
def test_law_suppression_is_what_one_box_after_another_gives(
    corner: np.ndarray, side: np.ndarray, score: np.ndarray, max_iou: float
) -> None:
    boxes = np.concatenate([corner, corner + side], axis=1)
    kept: list[int] = []
    for i in sorted(range(12), key=lambda k: (-score[k], k)):
        if all(pairwise_iou(boxes[[i]], boxes[[k]])[0, 0] <= max_iou for k in kept):
            kept.append(i)
    assert non_maximum_suppression(boxes, score, max_iou).tolist() == kept


def test_selection_clips_to_the_image_and_drops_what_is_outside_or_not_finite() -> None:
    boxes = np.array(
        [[-20, 10, 30, 50], [630, 350, 700, 420], [700, 10, 800, 50], [10, 10, np.nan, 20], [5, 5, np.inf, 9]], float
    )
    found = select(boxes, np.array([0.9, 0.8, 0.7, 0.6, 0.5]), np.arange(5) % 4, (640, 360), 0.5)
    assert found.boxes.tolist() == [[-0.5, 10, 30, 50], [630, 350, 639.5, 359.5], [5, 5, 639.5, 9]]
    assert found.scores.tolist() == [0.9, 0.8, 0.5]
    assert found.classes.tolist() == [0, 1, 0]
