from __future__ import annotations

import numpy as np

from wibam_core.detection.boxes import select


def test_selection_clips_to_the_image_and_drops_what_is_outside_or_not_finite() -> None:
    boxes = np.array(
        [[-20, 10, 30, 50], [630, 350, 700, 420], [700, 10, 800, 50], [10, 10, np.nan, 20], [5, 5, np.inf, 9]], float
    )
    found = select(boxes, np.array([0.9, 0.8, 0.7, 0.6, 0.5]), np.arange(5) % 4, (640, 360), 0.5)
    assert found.boxes.tolist() == [[-0.5, 10, 30, 50], [630, 350, 639.5, 359.5], [5, 5, 639.5, 9]]
    assert found.scores.tolist() == [0.9, 0.8, 0.5]
    assert found.classes.tolist() == [0, 1, 0]
