"""Which frames form an instant: one Parquet file, one row per instant and camera, sorted by time."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from wibam_core.scene import FrameSet

_SCHEMA = pa.schema(
    [
        pa.field("time_ns", pa.int64(), nullable=False),
        pa.field("camera_id", pa.string(), nullable=False),
        pa.field("local_ns", pa.int64(), nullable=False),
        pa.field("frame_time_ns", pa.int64(), nullable=False),
    ]
)


def write_instants(path: Path, instants: Iterable[FrameSet]) -> None:
    """Write instants, sorted by time."""
    rows = sorted(
        (instant.time_ns, camera_id, instant.local_times_ns[camera_id], frame_time_ns)
        for instant in instants
        for camera_id, frame_time_ns in instant.frame_times_ns.items()
    )
    columns = zip(*rows, strict=True) if rows else [[] for _ in _SCHEMA]
    arrays = [pa.array(column, type=field.type) for column, field in zip(columns, _SCHEMA, strict=True)]
    pq.write_table(pa.table(arrays, schema=_SCHEMA), path, compression="zstd")


def read_instants(path: Path) -> list[FrameSet]:
    """Read what `write_instants` wrote, sorted by time."""
    columns = (column.to_pylist() for column in pq.read_table(path, schema=_SCHEMA).columns)
    instants = []
    for time_ns, group in groupby(zip(*columns, strict=True), key=lambda row: row[0]):
        rows = list(group)
        instants.append(
            FrameSet(
                time_ns,
                {camera_id: frame_time_ns for _, camera_id, _, frame_time_ns in rows},
                {camera_id: local_ns for _, camera_id, local_ns, _ in rows},
            )
        )
    return instants
