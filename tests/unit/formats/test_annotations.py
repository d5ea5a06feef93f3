"""Annotations survive a round trip, with empty frames and unassociated boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from wibam_core.formats.annotations import read_annotations, write_annotations
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, Detections2D, MultiViewVehicle


def test_amodal_boxes_are_kept_where_they_are_known(tmp_path: Path) -> None:
    boxes = np.array([[0, 1, 2, 3.5], [5, 5, 9, 9]])
    amodal = np.array([[0, 1, 4, 3.5], [np.nan] * 4])
    sd = np.array([[0.5, 1, 3, 1], [np.nan] * 4])
    seen = Detections2D("a", 101, boxes, np.ones(2), np.zeros(2, int), amodal, sd)
    plain = Detections2D("b", 101, boxes, np.ones(2), np.zeros(2, int))
    write_annotations(tmp_path / "a.parquet", [AnnotatedInstant(100, {"a": seen, "b": plain})])
    (read,) = read_annotations(tmp_path / "a.parquet")
    np.testing.assert_array_equal(read.detections["a"].amodal_boxes, amodal)
    np.testing.assert_array_equal(read.detections["a"].amodal_sd, sd)
    assert np.isnan(read.detections["b"].amodal_boxes).all()
    np.testing.assert_array_equal(read.detections["a"].whole_boxes, [amodal[0], boxes[1]])


def test_a_file_from_before_amodal_boxes_can_be_read(tmp_path: Path) -> None:
    seen = Detections2D("a", 101, np.array([[0, 1, 2, 3.5]]), np.ones(1), np.zeros(1, int))
    write_annotations(tmp_path / "a.parquet", [AnnotatedInstant(100, {"a": seen})])
    table = pq.read_table(tmp_path / "a.parquet")
    pq.write_table(table.drop([n for n in table.column_names if n.startswith("amodal")]), tmp_path / "a.parquet")
    (read,) = read_annotations(tmp_path / "a.parquet")
    np.testing.assert_array_equal(read.detections["a"].whole_boxes, seen.boxes)


def test_round_trip_keeps_boxes_vehicles_and_empty_frames(tmp_path: Path) -> None:
    a = Detections2D("a", 101, np.array([[0, 1, 2, 3.5], [5, 5, 9, 9]]), np.array([0.9, 0.4]), np.array([0, 3]))
    b = Detections2D("b", 99, np.zeros((0, 4)), np.zeros(0), np.zeros(0, int))
    c = Detections2D("c", 100, np.array([[7, 7, 8, 8.0]]), np.array([0.5]), np.array([2]))
    vehicle = MultiViewVehicle(0, 17, RoadUserClass.TRUCK, 1.5, -2.5, {"a": 1, "c": 0})
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
