"""Two networks on the same instants: the better one is told, and instants that are not the same are not compared."""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders import corner_rig
from wibam_core.config import EvaluateConfig
from wibam_core.errors import Conflict
from wibam_core.evaluation.comparison import compare_networks, held_out_from_both
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.geometry.projection import project_boxes
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, Detections2D, FrameSet, LabelledInstant, MultiViewVehicle, Vehicles3D

RIG = corner_rig(3)
TIMES = [index * 500_000_000 for index in range(12)]
RNG = np.random.default_rng(3)
SPOTS = np.array([[-6.0, -5], [0, 0], [6, 5], [-5, 6], [7, -6], [1, 9]])


def truth() -> np.ndarray:
    """Six cars that stand, boxes (6, 7)."""
    boxes = np.tile([0.0, 0, 0.75, 4.5, 1.8, 1.5, 0.4], (len(SPOTS), 1))
    boxes[:, :2] = SPOTS
    return boxes


def annotated(time_ns: int) -> AnnotatedInstant:
    boxes, count = truth(), len(SPOTS)
    detections = {
        camera_id: Detections2D(
            camera_id, time_ns, project_boxes(camera, boxes), np.ones(count), np.zeros(count, np.int64)
        )
        for camera_id, camera in RIG.items()
    }
    vehicles = tuple(
        MultiViewVehicle(i, i, RoadUserClass.CAR, *boxes[i, :2], dict.fromkeys(RIG, i)) for i in range(count)
    )
    return AnnotatedInstant(time_ns, detections, vehicles)


def found(error_m: float) -> list[Vehicles3D]:
    """What a network finds that errs by about so much along X and Y."""
    made = []
    for time_ns in TIMES:
        for camera_id in RIG:
            boxes = truth()
            boxes[:, :2] += RNG.normal(0.0, error_m, boxes[:, :2].shape)
            made.append(Vehicles3D.of(time_ns, boxes, camera_id=camera_id, scores=np.full(len(boxes), 0.9)))
    return made


def instants(times: list[int] = TIMES, offset_ns: int = 0) -> list[FrameSet]:
    return [FrameSet(t, dict.fromkeys(RIG, t), dict.fromkeys(RIG, t + offset_ns)) for t in times]


def test_the_better_one_is_told_with_an_interval_that_leaves_no_doubt() -> None:
    annotations = [annotated(time_ns) for time_ns in TIMES]
    seen = dict.fromkeys(RIG, np.ones(len(SPOTS)))
    labels = LabelTimeline(
        [LabelledInstant(Vehicles3D.of(time_ns, truth(), ids=np.arange(len(SPOTS))), seen) for time_ns in TIMES]
    )
    result = compare_networks(found(0.8), found(0.1), instants(), annotations, RIG, EvaluateConfig(), labels)
    assert result.instants == 12
    assert result.frames == 36
    assert result.labels == "hand"
    assert result.other_views.low is not None and result.other_views.low > 0
    assert result.first.figures is not None and result.second.figures is not None
    assert result.second.figures.ate_m.mean is not None and result.second.figures.ate_m.mean < 0.3
    assert result.significance is not None
    high = result.significance["ate_m"].high
    assert high is not None and high < 0


def test_one_and_the_same_does_not_differ() -> None:
    one = found(0.3)
    result = compare_networks(one, one, instants(), [annotated(t) for t in TIMES], RIG, EvaluateConfig())
    assert result.labels == "none"
    assert result.significance is None
    assert result.other_views.difference == pytest.approx(0.0)
    assert result.first == result.second


def test_only_instants_of_both_test_parts_with_the_same_frames_are_compared() -> None:
    both = held_out_from_both(instants(), instants(), TIMES[6:], [*TIMES[:2], *TIMES[8:]])
    assert [one.time_ns for one in both] == TIMES[8:]
    result = compare_networks(found(0.1), found(0.1), both, [annotated(t) for t in TIMES], RIG, EvaluateConfig())
    assert result.instants == 4
    assert result.first.consistency.pairs == 4 * 3 * 6 * 2
    with pytest.raises(Conflict, match="no held-out instant in common"):
        held_out_from_both(instants(), instants(), TIMES[:6], TIMES[6:])
    with pytest.raises(Conflict, match="no held-out instant in common"):
        held_out_from_both(instants(), instants(offset_ns=1), TIMES, TIMES)  # other frames
