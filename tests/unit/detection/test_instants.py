"""From single frames to instants, and back."""

import numpy as np

from wibam_core.detection.instants import annotated, by_frame, frames_of
from wibam_core.scene import Boxes2D, FrameKey, FrameSet


def some(count: int) -> Boxes2D:
    boxes = np.arange(4.0 * count).reshape(-1, 4) + [0, 0, 9, 9]
    return Boxes2D(boxes, np.full(count, 0.5), np.zeros(count, np.int64), boxes - 1, np.ones((count, 4)))


def test_a_frame_of_two_instants_belongs_to_both() -> None:
    sets = [FrameSet(0, {"b": 3, "a": 1}, {"b": 103, "a": 201}), FrameSet(10, {"b": 3}, {"b": 103})]
    detected = {FrameKey("a", 201): some(1), FrameKey("b", 103): some(2), FrameKey("b", 150): some(3)}
    assert frames_of(sets) == [("a", 201), ("b", 103)]
    first, second = annotated(sets, detected)
    assert (list(first.detections), list(second.detections)) == (["a", "b"], ["b"])
    assert (len(first.detections["a"]), len(second.detections["b"])) == (1, 2)
    assert second.detections["b"].frame_time_ns == 3
    np.testing.assert_array_equal(first.detections["b"].amodal_boxes, some(2).amodal_boxes)


def test_instants_of_one_clock_come_apart_and_together_again() -> None:
    sets = [FrameSet(t, {"a": t + 1, "b": t - 1}, {"a": t + 1, "b": t - 1}) for t in (0, 40)]
    detected = {frame: some(number) for number, frame in enumerate(frames_of(sets))}
    apart, found = by_frame(annotated(sets, detected))
    assert [(s.time_ns, dict(s.local_times_ns)) for s in apart] == [(s.time_ns, dict(s.local_times_ns)) for s in sets]
    assert {frame: len(boxes.boxes) for frame, boxes in found.items()} == {
        frame: number for number, frame in enumerate(frames_of(sets))
    }
