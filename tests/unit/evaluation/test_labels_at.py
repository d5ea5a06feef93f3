from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.scene import LabelledInstant, Vehicles3D

MS = 1_000_000


def instant(time_ms: int, rows: dict[int, tuple[float, float]], visibility: float = 1.0) -> LabelledInstant:
    boxes = np.array([[x, 0, 0.7, 4, 2, 1.4, yaw] for x, yaw in rows.values()]).reshape(-1, 7)
    vehicles = Vehicles3D.of(time_ms * MS, boxes, ids=np.array(list(rows), dtype=np.int64))
    return LabelledInstant(vehicles, {"a": np.full(len(rows), visibility)})


def test_states_are_interpolated_at_the_frames_own_time_by_vehicle() -> None:
    timeline = LabelTimeline(
        [instant(160, {2: (50.0, 0), 1: (1.6, 3.1)}, 0.5), instant(0, {1: (0.0, -3.1), 2: (50.0, 0)})]
    )
    found = timeline.at(40 * MS)
    assert found is not None
    assert found.vehicles.time_ns == 40 * MS
    rows = dict(zip(found.vehicles.ids.tolist(), found.vehicles.boxes, strict=True))
    assert rows[1][0] == pytest.approx(0.4)
    assert abs(rows[1][6]) > 3.1  # the shorter way, over ±π
    np.testing.assert_allclose(found.visibility["a"], [0.875, 0.875])


def test_a_vehicle_that_only_one_neighbour_has_is_kept_but_hidden() -> None:
    timeline = LabelTimeline([instant(0, {1: (0.0, 0)}), instant(100, {1: (1.0, 0), 5: (9.0, 0)})])
    found = timeline.at(50 * MS)
    assert found is not None
    assert found.vehicles.ids.tolist() == [1, 5]
    assert found.visibility["a"].tolist() == [1.0, 0.0]


def test_alone_a_label_is_moved_by_its_velocity() -> None:
    alone = replace(instant(0, {1: (0.0, 0), 2: (9.0, 0)}), velocities_mps=np.array([[10.0, -5.0], [np.nan, np.nan]]))
    found = LabelTimeline([alone]).at(20 * MS)
    assert found is not None
    np.testing.assert_allclose(found.vehicles.boxes[:, :2], [[0.2, -0.1], [9.0, 0.0]])
    assert found.vehicles.time_ns == 20 * MS
    assert LabelTimeline([alone]).at(50 * MS) is None


def test_exact_within_a_millisecond_and_nothing_far_from_any_label() -> None:
    timeline = LabelTimeline([instant(0, {1: (0.0, 0)}), instant(5000, {1: (9.0, 0)})])
    at = timeline.at(MS)
    assert at is not None
    assert at.vehicles.time_ns == 0
    near = timeline.at(5030 * MS)
    assert near is not None
    assert near.vehicles.boxes[0, 0] == 9.0
    assert timeline.at(2500 * MS) is None
    assert timeline.at(5041 * MS) is None
    assert LabelTimeline([]).at(0) is None


def test_labelled_but_empty_instants_are_labels_too() -> None:
    found = LabelTimeline([instant(0, {}), instant(100, {})]).at(50 * MS)
    assert found is not None
    assert len(found.vehicles) == 0
