"""Hand labels (or truth): 7DoF boxes per instant with each camera's visibility. They only ever evaluate.

Parquet with the columns of `SCHEMA`, or JSON: a list of objects with the same fields, or
``{"labels": [...], "empty_instants": [time_ns, ...], "do_not_care": [{"time_ns": ..., "polygon": [[x, y], ...]}]}``. An
empty instant was labelled and holds no vehicle. Parquet has the last two in its metadata.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from wibam_core.documents.hand_labels import FARTHEST_M, LATEST_NS, MOST_CORNERS, MOST_REGIONS
from wibam_core.errors import InvalidLabels
from wibam_core.formats import tables
from wibam_core.geometry.box3d import BOX_FIELDS, SIZE, XYZ
from wibam_core.road_users import CLASSES
from wibam_core.scene import FloatArray, LabelledInstant, Vehicles3D
from wibam_core.text import NotUnicode, decode_text, read_json

_DO_NOT_CARE = b"wibam.do_not_care"
_REGIONS = 'Each is {"time_ns": ..., "polygon": [[x, y], ...]} with three corners at least, m in the world.'
_VELOCITY = ("velocity_x_mps", "velocity_y_mps")
#: ``vehicle_id`` is the same for one vehicle over time, or absent. ``visibility``: camera id -> share of the
#: silhouette that the camera sees, in [0, 1]; a camera that is not named does not see the vehicle. The velocity may be
#: absent.
SCHEMA = pa.schema(
    [
        pa.field("time_ns", pa.int64(), nullable=False),
        pa.field("vehicle_id", pa.int64()),
        tables.CLASS_COLUMN,
        *tables.BOX_COLUMNS,
        pa.field("visibility", pa.map_(pa.string(), pa.float64()), nullable=False),
        *(pa.field(name, pa.float64()) for name in _VELOCITY),
    ]
)

_FORMAT = (
    f"Labels are a Parquet table with the columns {', '.join(SCHEMA.names)}, one row per vehicle and instant, or JSON: "
    "a list of objects with these fields. See docs/site-format.md."
)


def write_labels(path: Path, instants: Iterable[LabelledInstant]) -> None:
    """Write labels, sorted by time; as JSON where the path ends so, else as Parquet."""
    ordered = sorted(instants, key=lambda instant: instant.vehicles.time_ns)
    rows = [row for instant in ordered for row in _rows(instant)]
    empty = [instant.vehicles.time_ns for instant in ordered if not len(instant.vehicles)]
    regions = [
        {"time_ns": int(instant.vehicles.time_ns), "polygon": polygon.tolist()}
        for instant in ordered
        for polygon in instant.do_not_care
    ]
    if path.suffix.lower() == ".json":
        whole = {"labels": rows, "empty_instants": empty, **({"do_not_care": regions} if regions else {})}
        path.write_text(json.dumps(whole, indent=1), encoding="utf-8")
        return
    for row in rows:
        row["visibility"] = list(row["visibility"].items())
    notes = {_DO_NOT_CARE: json.dumps(regions).encode()} if regions else {}
    tables.write_table(path, _table(rows), empty_instants=[(time, None) for time in empty], notes=notes)


def read_labels(path: Path) -> list[LabelledInstant]:
    """Read labels, sorted by time.

    Raises:
        InvalidLabels: naming the field or row that is wrong.
    """
    if _is_parquet(path):
        table, empty_pairs = tables.read_table(path, SCHEMA, "labels", InvalidLabels)
        empty = [time for time, _ in empty_pairs]
        regions = _regions(tables.read_note(pq.read_schema(path), _DO_NOT_CARE, path.name, InvalidLabels), path.name)
    else:
        table, empty, regions = _read_json(path)
    table = table.sort_by([("time_ns", "ascending")])
    times = table["time_ns"].to_numpy()
    ids = np.array([-1 if i is None else i for i in table["vehicle_id"].to_pylist()], np.int64)
    classes = tables.class_indices(table, InvalidLabels)
    boxes = tables.stack_columns(table, BOX_FIELDS)
    visibility = [dict(cell) for cell in table["visibility"].to_pylist()]
    velocities = np.stack([np.array(table[name].to_pylist(), dtype=np.float64) for name in _VELOCITY], axis=-1)
    if np.isinf(velocities).any():
        raise InvalidLabels("a label has a velocity that is not finite", hint="Correct it, or leave it out.")
    _check(times, boxes, ids, visibility)
    _check_times([*times.tolist(), *empty])
    starts = np.flatnonzero(np.r_[True, np.diff(times) != 0]) if len(times) else np.empty(0, np.int64)
    found = []
    for a, b in pairwise([*starts.tolist(), len(times)]):
        cameras = sorted({camera for cell in visibility[a:b] for camera in cell})
        found.append(
            LabelledInstant(
                Vehicles3D.of(int(times[a]), boxes[a:b], classes[a:b], ids[a:b]),
                {camera: np.array([cell.get(camera, 0.0) for cell in visibility[a:b]]) for camera in cameras},
                velocities[a:b],
            )
        )
    found += [LabelledInstant(Vehicles3D.of(time, np.empty((0, 7))), {}) for time in empty]
    return _with_regions(sorted(found, key=lambda instant: instant.vehicles.time_ns), regions)


def _with_regions(found: list[LabelledInstant], regions: list[tuple[int, FloatArray]]) -> list[LabelledInstant]:
    by_time: dict[int, list[FloatArray]] = {}
    for time_ns, polygon in regions:
        by_time.setdefault(time_ns, []).append(polygon)
    if unknown := sorted(by_time.keys() - {instant.vehicles.time_ns for instant in found}):
        raise InvalidLabels(
            f"do_not_care names {unknown[0]} ns, where nothing is labelled",
            hint="Name a labelled instant, or list it among the empty_instants.",
        )
    for time_ns, polygons in by_time.items():
        if len(polygons) > MOST_REGIONS:
            raise InvalidLabels(
                f"do_not_care has {len(polygons)} regions at {time_ns} ns, and an instant has {MOST_REGIONS} at most",
                hint="Join those that lie beside each other.",
            )
    return [replace(one, do_not_care=tuple(by_time.get(one.vehicles.time_ns, ()))) for one in found]


def _regions(given: Any, name: str) -> list[tuple[int, FloatArray]]:
    """Instant and polygon of each region."""
    try:
        found = [(int(one["time_ns"]), np.array(one["polygon"], np.float64)) for one in given]
    except (TypeError, ValueError, KeyError, OverflowError) as cause:
        raise InvalidLabels(f"{name}: do_not_care is no list of regions", hint=_REGIONS) from cause
    for time_ns, polygon in found:
        if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3 or not np.isfinite(polygon).all():
            raise InvalidLabels(f"{name}: do_not_care has a polygon that is none", hint=_REGIONS)
        if len(polygon) > MOST_CORNERS:
            raise InvalidLabels(
                f"{name}: do_not_care has a polygon of {len(polygon)} corners at {time_ns} ns, {MOST_CORNERS} at most",
                hint="Draw it more simply, or as several.",
            )
    return found


def _is_parquet(path: Path) -> bool:
    """By content: an uploaded file may have lost its name."""
    try:
        with path.open("rb") as file:
            return file.read(4) == b"PAR1"
    except OSError as cause:
        raise InvalidLabels(f"{path.name} cannot be read: {cause}", hint="Upload it again.") from cause


def _rows(instant: LabelledInstant) -> list[dict[str, Any]]:
    v = instant.vehicles
    return [
        {
            "time_ns": int(v.time_ns),
            "vehicle_id": None if v.ids[i] < 0 else int(v.ids[i]),
            "class": CLASSES[int(v.classes[i])].value,
            **{name: float(value) for name, value in zip(BOX_FIELDS, v.boxes[i], strict=True)},
            "visibility": {camera: float(values[i]) for camera, values in instant.visibility.items()},
            **_velocity(instant.velocities_mps[i]),
        }
        for i in range(len(v))
    ]


def _velocity(velocity: FloatArray) -> dict[str, float]:
    """Left out where it is unknown."""
    return dict(zip(_VELOCITY, velocity.tolist(), strict=True)) if np.isfinite(velocity).all() else {}


def _table(rows: list[dict[str, Any]]) -> pa.Table:
    """Rows as a table of `SCHEMA`; raises pyarrow's errors on wrong values."""
    columns = {}
    for column in SCHEMA:
        plain = pa.string() if pa.types.is_dictionary(column.type) else column.type
        columns[column.name] = pa.array([row.get(column.name) for row in rows], type=plain).cast(column.type)
    return pa.table(columns)


def _read_json(path: Path) -> tuple[pa.Table, list[int], list[tuple[int, FloatArray]]]:
    try:
        data = read_json(decode_text(path.read_bytes()))
    except NotUnicode as cause:
        raise InvalidLabels(
            f"{path.name} is neither Parquet nor JSON: {cause}", hint=f"Save it as UTF-8. {_FORMAT}"
        ) from cause
    except (OSError, ValueError, RecursionError) as cause:
        raise InvalidLabels(f"{path.name} is neither Parquet nor JSON ({cause})", hint=_FORMAT) from cause
    rows = data.get("labels") if isinstance(data, dict) else data
    empty = data.get("empty_instants", []) if isinstance(data, dict) else []
    regions = _regions(data.get("do_not_care", []) if isinstance(data, dict) else [], path.name)
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows) or not isinstance(empty, list):
        raise InvalidLabels(f"{path.name} is JSON, but holds no list of labels", hint=_FORMAT)
    rows = [
        {**row, "visibility": list(row["visibility"].items())} if isinstance(row.get("visibility"), dict) else row
        for row in rows
    ]
    for i, row in enumerate(rows):
        missing = [column.name for column in SCHEMA if not column.nullable and row.get(column.name) is None]
        if missing:
            raise InvalidLabels(f"{path.name}: label {i} has no {missing[0]}", hint=_FORMAT, field=missing[0])
    try:
        table = tables.conform(_table(rows), SCHEMA, path.name, "labels", InvalidLabels)
        return table, [int(t) for t in empty], regions
    except (pa.ArrowInvalid, pa.ArrowTypeError, TypeError, ValueError, OverflowError) as cause:
        raise InvalidLabels(f"{path.name}: {cause}", hint="Correct the value's type.") from cause


def _check_times(times_ns: Sequence[int]) -> None:
    beyond = [time_ns for time_ns in times_ns if abs(time_ns) > LATEST_NS]
    if beyond:
        raise InvalidLabels(
            f"{beyond[0]} ns is no time of a recording", hint="Times are in nanoseconds on the reference clock."
        )


def _check(times: np.ndarray, boxes: np.ndarray, ids: np.ndarray, visibility: list[dict[str, float]]) -> None:
    for i, box in enumerate(boxes):
        where = f"label {i} at {times[i]} ns"
        if not np.isfinite(box).all():
            raise InvalidLabels(f"{where} has a number that is not finite", hint="Correct it.", row=i)
        if (np.abs(box[XYZ]) > FARTHEST_M).any():
            raise InvalidLabels(
                f"{where} lies more than {FARTHEST_M / 1000:,.0f} km from the world's origin", hint="Correct it.", row=i
            )
        if (box[SIZE] <= 0).any():
            raise InvalidLabels(f"{where} has a size that is not positive", hint="Sizes are in metres.", row=i)
        for camera, share in visibility[i].items():
            if share is None or not 0 <= share <= 1:
                raise InvalidLabels(
                    f"{where}: visibility in {camera} is {share}", hint="Visibility lies between 0 and 1.", row=i
                )
    known = [(int(t), int(i)) for t, i in zip(times, ids, strict=True) if i >= 0]
    if len(set(known)) != len(known):
        twice = next(key for key in known if known.count(key) > 1)
        raise InvalidLabels(f"vehicle {twice[1]} is labelled twice at {twice[0]} ns", hint="Remove one of the two.")
