"""7DoF tracks: one row per vehicle and instant."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from wibam_core.errors import InputError
from wibam_core.formats import tables
from wibam_core.geometry.box3d import BOX_FIELDS
from wibam_core.road_users import CLASSES
from wibam_core.scene import Track

#: Rows that are read together: a page, an hour's box or one track are found in a few such parts.
GROUP_ROWS = 50_000
_MOTION = ("vx_mps", "vy_mps", "yaw_rate_radps")

#: Sorted by time, then track. ``speed_mps`` is the length of (vx, vy).
SCHEMA = pa.schema(
    [
        pa.field("time_ns", pa.int64(), nullable=False),
        pa.field("track_id", pa.int64(), nullable=False),
        tables.CLASS_COLUMN,
        *tables.BOX_COLUMNS,
        pa.field("vx_mps", pa.float64(), nullable=False),
        pa.field("vy_mps", pa.float64(), nullable=False),
        pa.field("speed_mps", pa.float64(), nullable=False),
        pa.field("yaw_rate_radps", pa.float64(), nullable=False),
        *tables.SD_COLUMNS,
    ]
)


def to_table(tracks: Iterable[Track]) -> pa.Table:
    """Tracks as a table of `SCHEMA`, sorted by time, then track.

    Raises:
        ValueError: two tracks share an id.
    """
    tracks = list(tracks)
    lengths = [len(track) for track in tracks]
    ids = [track.track_id for track in tracks]
    if len(set(ids)) != len(ids):
        raise ValueError("track ids must be unique")
    stack = lambda parts, width: np.concatenate([np.empty((0, width)), *parts])  # noqa: E731
    velocities = stack([track.velocities_mps for track in tracks], 2)
    columns = {
        "time_ns": np.concatenate([np.empty(0, np.int64), *(track.times_ns for track in tracks)]).astype(np.int64),
        "track_id": np.repeat(np.array(ids, np.int64), lengths),
        "class": tables.class_column(np.repeat(np.array([t.vehicle_class.number for t in tracks], np.int64), lengths)),
        **tables.float_columns(BOX_FIELDS, stack([track.boxes for track in tracks], 7)),
        "vx_mps": velocities[:, 0],
        "vy_mps": velocities[:, 1],
        "speed_mps": np.hypot(velocities[:, 0], velocities[:, 1]),
        "yaw_rate_radps": np.concatenate([np.empty(0), *(track.yaw_rates_radps for track in tracks)]),
        **tables.float_columns(tables.SD_FIELDS, stack([track.sd for track in tracks], 7)),
    }
    return pa.table(columns, schema=SCHEMA).sort_by([("time_ns", "ascending"), ("track_id", "ascending")])


def write_tracks(path: Path, tracks: Iterable[Track]) -> None:
    """Write tracks, sorted by time, then track."""
    tables.write_table(path, to_table(tracks), group_rows=GROUP_ROWS)


class TrackWriter:
    """Writes a file of tracks piece by piece, in constant memory. A context manager.

    States may come in any order, as long as none is before a time up to which all were said to be there.

    Args:
        path: of the file; it is there once the writer is closed.
    """

    def __init__(self, path: Path) -> None:
        self._file = pq.ParquetWriter(path, SCHEMA, compression="zstd")
        self._waiting = SCHEMA.empty_table()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def add(self, states: pa.Table) -> None:
        """Take in states, a table of `SCHEMA`."""
        self._waiting = pa.concat_tables([self._waiting, states])

    def settle(self, before_ns: int | None = None) -> None:
        """Write the states before a time, or all: no other state before it will come."""
        ready = self._waiting
        if before_ns is not None:
            is_ready = pc.less(ready["time_ns"], before_ns)
            ready, self._waiting = ready.filter(is_ready), ready.filter(pc.invert(is_ready))
        else:
            self._waiting = SCHEMA.empty_table()
        if ready.num_rows:
            self._file.write_table(
                ready.unify_dictionaries().sort_by([("time_ns", "ascending"), ("track_id", "ascending")])
            )


def span_of(path: Path) -> tuple[int, int] | None:
    """The first and the last time of a file of tracks, from its statistics; None where it holds no state."""
    found = pq.read_metadata(path)
    column = SCHEMA.get_field_index("time_ns")
    groups = [found.row_group(number).column(column).statistics for number in range(found.num_row_groups)]
    groups = [group for group in groups if group is not None and group.has_min_max]
    return (min(group.min for group in groups), max(group.max for group in groups)) if groups else None


def read_tracks(path: Path, start_ns: int | None = None, end_ns: int | None = None) -> list[Track]:
    """Read tracks, sorted by id.

    Args:
        path: the file.
        start_ns: only states from this time on; None: all. What cannot hold any is not read.
        end_ns: only states before this time; None: all.

    Raises:
        InputError: the file is not of this format, or a track has two states at one time.
    """
    between = [("time_ns", ">=", start_ns)] if start_ns is not None else []
    between += [("time_ns", "<", end_ns)] if end_ns is not None else []
    table, _ = tables.read_table(path, SCHEMA, "tracks", filters=between or None)
    table = table.sort_by([("track_id", "ascending"), ("time_ns", "ascending")])
    classes = tables.class_indices(table)
    track_ids, times = table["track_id"].to_numpy(), table["time_ns"].to_numpy()
    boxes = tables.stack_columns(table, BOX_FIELDS)
    sd = tables.stack_columns(table, tables.SD_FIELDS)
    motion = tables.stack_columns(table, _MOTION)
    unique, starts = np.unique(track_ids, return_index=True)
    tracks = []
    for track_id, (a, b) in zip(unique, pairwise([*starts, len(track_ids)]), strict=True):
        try:
            tracks.append(
                Track(
                    int(track_id),
                    CLASSES[int(classes[a])],
                    times[a:b],
                    boxes[a:b],
                    sd[a:b],
                    motion[a:b, :2],
                    motion[a:b, 2],
                )
            )
        except ValueError as cause:
            raise InputError(f"{path.name}: track {track_id}: {cause}", hint="A track has one state a time.") from cause
    return tracks
