"""3D boxes per instant and detecting camera: fits and network output."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa

from wibam_core.formats import tables
from wibam_core.geometry.box3d import BOX_FIELDS
from wibam_core.scene import Vehicles3D

#: One row per box. ``camera_id`` is null for boxes that belong to no single camera.
SCHEMA = pa.schema(
    [
        pa.field("time_ns", pa.int64(), nullable=False),
        pa.field("camera_id", pa.string()),
        pa.field("vehicle_id", pa.int64(), nullable=False),
        tables.CLASS_COLUMN,
        pa.field("score", pa.float64(), nullable=False),
        *tables.BOX_COLUMNS,
        *tables.SD_COLUMNS,
    ]
)


def write_vehicles3d(path: Path, vehicles: Iterable[Vehicles3D]) -> None:
    """Write, sorted by time, then camera. Instants without a vehicle are kept."""
    ordered = sorted(vehicles, key=_key)
    empty = [(v.time_ns, v.camera_id) for v in ordered if not len(v)]
    tables.write_table(path, table_of(ordered), empty_instants=empty)


def table_of(vehicles: Iterable[Vehicles3D]) -> pa.Table:
    """The rows of vehicles, in their order."""
    full = [v for v in vehicles if len(v)]
    n_of = [len(v) for v in full]
    columns = {
        "time_ns": np.repeat(np.array([v.time_ns for v in full], np.int64), n_of),
        "camera_id": pa.array([v.camera_id for v, n in zip(full, n_of, strict=True) for _ in range(n)], pa.string()),
        "vehicle_id": _concatenate([v.ids for v in full], np.int64),
        "class": tables.class_column(_concatenate([v.classes for v in full], np.int64)),
        "score": _concatenate([v.scores for v in full], np.float64),
        **tables.float_columns(BOX_FIELDS, _concatenate([v.boxes.ravel() for v in full], np.float64)),
        **tables.float_columns(tables.SD_FIELDS, _concatenate([v.sd.ravel() for v in full], np.float64)),
    }
    return pa.table(columns, schema=SCHEMA)


def read_vehicles3d(path: Path) -> list[Vehicles3D]:
    """Read, sorted by time, then camera; one entry per instant and camera.

    Raises:
        InputError: the file is not of this format.
    """
    table, empty = tables.read_table(path, SCHEMA, "vehicles")
    found = vehicles_of(table)
    found += [Vehicles3D.of(time, np.empty((0, 7)), camera_id=camera) for time, camera in empty]
    return sorted(found, key=_key)


def vehicles_of(table: pa.Table) -> list[Vehicles3D]:
    """What rows of this format say, one entry for those beside each other of one instant and camera."""
    times = table["time_ns"].to_numpy()
    cameras = table["camera_id"].to_pylist()
    boxes = tables.stack_columns(table, BOX_FIELDS)
    sd = tables.stack_columns(table, tables.SD_FIELDS)
    classes = tables.class_indices(table)
    ids, scores = table["vehicle_id"].to_numpy(), table["score"].to_numpy()
    starts = [i for i in range(len(times)) if i == 0 or (times[i], cameras[i]) != (times[i - 1], cameras[i - 1])]
    return [
        Vehicles3D(int(times[a]), boxes[a:b], classes[a:b], ids[a:b], scores[a:b], sd[a:b], cameras[a])
        for a, b in pairwise([*starts, len(times)])
    ]


def _key(vehicles: Vehicles3D) -> tuple[int, str]:
    return vehicles.time_ns, vehicles.camera_id or ""


def _concatenate(parts: list[np.ndarray], dtype: type) -> np.ndarray:
    return np.concatenate(parts) if parts else np.empty(0, dtype)
