"""7DoF tracks: one row per vehicle and instant."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa

from wibam_core.errors import InputError
from wibam_core.formats import tables
from wibam_core.geometry.box3d import BOX_FIELDS
from wibam_core.road_users import CLASSES
from wibam_core.scene import Track

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
    tables.write_table(path, to_table(tracks))


def read_tracks(path: Path) -> list[Track]:
    """Read tracks, sorted by id.

    Raises:
        InputError: the file is not of this format, or a track has two states at one time.
    """
    table, _ = tables.read_table(path, SCHEMA, "tracks")
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
