"""The presentation timestamps of all frames of the recordings: one Parquet file, one row per frame."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

_SCHEMA = pa.schema(
    [
        pa.field("camera_id", pa.string(), nullable=False),
        pa.field("local_ns", pa.int64(), nullable=False),
    ]
)


def write_timestamps(path: Path, times_ns: Mapping[str, NDArray[np.int64]]) -> None:
    """Write times.

    Args:
        path: the file.
        times_ns: camera id -> (N,) times on that camera's own clock, ascending. A camera without any is left out.
    """
    cameras = np.repeat(list(times_ns), [len(times) for times in times_ns.values()])
    columns = [pa.array(cameras, type=pa.string()), pa.array(np.concatenate(list(times_ns.values())))]
    pq.write_table(pa.table(columns, schema=_SCHEMA), path, compression="zstd")


def read_timestamps(path: Path) -> dict[str, NDArray[np.int64]]:
    """Read what `write_timestamps` wrote."""
    table = pq.read_table(path, schema=_SCHEMA)
    cameras, times = table["camera_id"].to_numpy(), table["local_ns"].to_numpy()
    return {camera_id: times[cameras == camera_id] for camera_id in table["camera_id"].unique().to_pylist()}
