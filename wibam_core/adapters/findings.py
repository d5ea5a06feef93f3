"""What a job's stages say of one instant, read without the rest of their files."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from wibam_core.adapters.results import JobResults
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.artifact import Artifact
from wibam_core.association.rays import ground_points
from wibam_core.documents.findings import FoundBox, FoundVehicle, InstantFindings, SeenBox
from wibam_core.formats.detections import AMODAL_BOX, BOX
from wibam_core.formats.tables import class_named
from wibam_core.geometry.box3d import BOX_FIELDS
from wibam_core.jobs.records import Job
from wibam_core.scene import CameraRig

Row = dict[str, Any]


def findings(results: JobResults, job: Job, time_ns: int) -> InstantFindings:
    """Of an instant that the job has.

    Args:
        results: of all jobs.
        job: which.
        time_ns: of one of its instants, reference clock.
    """
    rig = results.read(job, catalogue.RIG)
    boxes = sorted(
        _rows(results, job, catalogue.ANNOTATIONS, time_ns), key=lambda row: (row["camera_id"], row["index"])
    )
    seen = [row for row in boxes if row["index"] >= 0 and row["camera_id"] in rig]
    return InstantFindings(
        time_ns=time_ns,
        detections={camera: _seen(list(rows), rig, camera) for camera, rows in groupby(seen, lambda r: r["camera_id"])},
        vehicles=_vehicles(seen),
        fits=tuple(_box(row) for row in _rows(results, job, catalogue.FITS, time_ns)),
        baseline=_by_camera(_rows(results, job, catalogue.PREDICTIONS_BASELINE, time_ns)),
        finetuned=_by_camera(_rows(results, job, catalogue.PREDICTIONS_FINETUNED, time_ns)),
    )


def _rows(results: JobResults, job: Job, artifact: Artifact[Any], time_ns: int) -> list[Row]:
    """The rows of an instant; none where the stage has not made the artifact."""
    made = results.finished(job)
    if not made.has(artifact):
        return []
    rows: list[Row] = pq.read_table(made.local(artifact), filters=[("time_ns", "=", time_ns)]).to_pylist()
    return rows


def _seen(rows: list[Row], rig: CameraRig, camera_id: str) -> tuple[SeenBox, ...]:
    amodal = [[row[name] for name in AMODAL_BOX] for row in rows]
    visible = [[row[name] for name in BOX] for row in rows]
    whole = np.array([a if None not in a else v for a, v in zip(amodal, visible, strict=True)], dtype=np.float64)
    classes = np.array([class_named(row["class"]).number for row in rows], dtype=np.int64)
    points = ground_points(rig[camera_id], whole, classes)
    return tuple(
        SeenBox.model_validate(
            {
                "box_px": visible[number],
                "whole_px": None if None in amodal[number] else amodal[number],
                "class": row["class"],
                "score": row["score"],
                "vehicle": row["obj_id"],
                "ground_m": points[number].tolist() if np.isfinite(points[number]).all() else None,
            }
        )
        for number, row in enumerate(rows)
    )


def _vehicles(seen: list[Row]) -> tuple[FoundVehicle, ...]:
    members: dict[int, list[Row]] = {}
    for row in seen:
        if row["obj_id"] is not None:
            members.setdefault(row["obj_id"], []).append(row)
    return tuple(
        FoundVehicle.model_validate(
            {
                "id": obj_id,
                "track": rows[0]["track_id"],
                "class": rows[0]["vehicle_class"],
                "x_m": rows[0]["vehicle_x_m"],
                "y_m": rows[0]["vehicle_y_m"],
                "cameras": tuple(row["camera_id"] for row in rows),
            }
        )
        for obj_id, rows in sorted(members.items())
    )


def _by_camera(rows: list[Row]) -> dict[str, tuple[FoundBox, ...]]:
    found: dict[str, list[FoundBox]] = {}
    for row in rows:
        found.setdefault(str(row["camera_id"]), []).append(_box(row))
    return {camera_id: tuple(boxes) for camera_id, boxes in found.items()}


def _box(row: Row) -> FoundBox:
    values = {"box": [row[name] for name in BOX_FIELDS], "class": row["class"], "score": row["score"]}
    return FoundBox.model_validate({**values, "id": row["vehicle_id"]})
