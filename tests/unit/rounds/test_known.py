"""How much of what moves a detector finds by itself."""

import numpy as np
import pytest

from tests.multiview import crossing
from wibam_core.detection.instants import annotated, by_frame
from wibam_core.rounds.known import share_known
from wibam_core.scene import AnnotatedInstant, Boxes2D, FrameKey, FrameSet


@pytest.fixture(scope="module")
def seen() -> tuple[list[FrameSet], dict[FrameKey, Boxes2D], list[AnnotatedInstant]]:
    """Frames, what is in them, and the instants with their vehicles, most of which move."""
    instants = crossing(duration_s=4.0).instants[::2]
    frames, detected = by_frame(instants)
    return frames, detected, instants


def without(detected: dict[FrameKey, Boxes2D], every: int) -> dict[FrameKey, Boxes2D]:
    return {frame: boxes.where(np.arange(len(boxes.boxes)) % every > 0) for frame, boxes in detected.items()}


def test_a_detector_that_finds_all_knows_all_and_one_that_finds_half_half(
    seen: tuple[list[FrameSet], dict[FrameKey, Boxes2D], list[AnnotatedInstant]],
) -> None:
    frames, detected, instants = seen
    assert share_known(frames, instants, detected) == 1.0
    half = share_known(frames, instants, without(detected, 2))
    assert half is not None and 0.3 < half < 0.7


def test_who_stands_or_is_seen_by_one_camera_is_not_asked_for(
    seen: tuple[list[FrameSet], dict[FrameKey, Boxes2D], list[AnnotatedInstant]],
) -> None:
    frames, detected, instants = seen
    assert share_known(frames, annotated(frames, detected), detected) is None  # no vehicles
    standing = [
        AnnotatedInstant(instants[0].time_ns + k * 160_000_000, instants[0].detections, instants[0].vehicles)
        for k in range(10)
    ]
    assert share_known([frames[0]] * 10, standing, detected) is None
