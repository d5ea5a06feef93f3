"""Annotations survive a round trip, with empty frames and unassociated boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wibam_core.formats.annotations import read_annotations, write_annotations
from wibam_core.scene import AnnotatedInstant, Detections2D, MultiViewVehicle, VehicleClass


def test_round_trip_keeps_boxes_vehicles_and_empty_frames(tmp_path: Path) -> None:
    a = Detections2D("a", 101, np.array([[0, 1, 2, 3.5], [5, 5, 9, 9]]), np.array([0.9, 0.4]), np.array([0, 3]))
    b = Detections2D("b", 99, np.zeros((0, 4)), np.zeros(0), np.zeros(0, int))
    c = Detections2D("c", 100, np.array([[7, 7, 8, 8.0]]), np.array([0.5]), np.array([2]))
    vehicle = MultiViewVehicle(0, 17, VehicleClass.TRUCK, 1.5, -2.5, {"a": 1, "c": 0})
    later = AnnotatedInstant(200, {"a": Detections2D("a", 201, a.boxes, a.scores, a.classes)})
    write_annotations(tmp_path / "a.parquet", [later, AnnotatedInstant(100, {"a": a, "b": b, "c": c}, (vehicle,))])

    first, second = read_annotations(tmp_path / "a.parquet")

    assert (first.time_ns, second.time_ns) == (100, 200)
    assert list(first.detections) == ["a", "b", "c"]
    assert first.vehicles == (vehicle,)
    assert second.vehicles == ()
    assert len(first.detections["b"]) == 0
    assert first.detections["b"].frame_time_ns == 99
    np.testing.assert_array_equal(first.detections["a"].boxes, a.boxes)
    np.testing.assert_array_equal(first.detections["a"].scores, a.scores)
    np.testing.assert_array_equal(first.detections["a"].classes, a.classes)
