"""2D boxes by the frame that they were detected in: one Parquet file, one row per box, px of the recording.

Frames are named by camera and that camera's own clock. A frame without a box is listed in the file's metadata, so that
"seen nothing" and "not looked at" stay apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from pathlib import Path

import numpy as np
import pyarrow as pa

from wibam_core.formats.tables import (
    CLASS_COLUMN,
    class_column,
    class_indices,
    float_columns,
    read_table,
    stack_columns,
    write_table,
)
from wibam_core.scene import Boxes2D, FrameKey

BOX = ("x0_px", "y0_px", "x1_px", "y1_px")
#: Columns of the box around the whole vehicle, hidden parts included, and of its standard deviations; null where
#: unknown.
AMODAL_BOX = tuple(f"amodal_{name}" for name in BOX)
AMODAL_SD = ("amodal_x0_sd_px", "amodal_y0_sd_px", "amodal_x1_sd_px", "amodal_y1_sd_px")

_SCHEMA = pa.schema(
    [
        pa.field("local_ns", pa.int64(), nullable=False),
        pa.field("camera_id", pa.string(), nullable=False),
        *(pa.field(name, pa.float64(), nullable=False) for name in (*BOX, "score")),
        CLASS_COLUMN,
        *(pa.field(name, pa.float64()) for name in (*AMODAL_BOX, *AMODAL_SD)),
    ]
)

_NONE = Boxes2D(np.empty((0, 4)), np.empty(0), np.empty(0, np.int64), np.empty((0, 4)), np.empty((0, 4)))


def write_detections(path: Path, detected: Mapping[FrameKey, Boxes2D]) -> None:
    """Write what was detected, sorted by camera and time."""
    frames = sorted(detected)
    found = [frame for frame in frames if len(detected[frame].boxes)]
    counts = [len(detected[frame].boxes) for frame in found]
    boxes, scores, classes, amodal, sd = (
        np.concatenate([column, *(detected[frame][number] for frame in found)]) for number, column in enumerate(_NONE)
    )
    columns = {
        "local_ns": pa.array(np.repeat(np.array([frame.local_ns for frame in found], np.int64), counts)),
        "camera_id": pa.array(np.repeat([frame.camera_id for frame in found], counts).tolist(), type=pa.string()),
        **float_columns(BOX, boxes),
        "score": pa.array(scores),
        "class": class_column(classes),
        **float_columns(AMODAL_BOX, amodal),
        **float_columns(AMODAL_SD, sd),
    }
    empty = [(frame.local_ns, frame.camera_id) for frame in frames if not len(detected[frame].boxes)]
    write_table(path, pa.table(columns, schema=_SCHEMA), empty_instants=empty)


def read_detections(path: Path) -> dict[FrameKey, Boxes2D]:
    """Read what `write_detections` wrote, sorted by camera and time.

    Raises:
        InputError: the file is no such table.
    """
    table, empty = read_table(path, _SCHEMA, "detections")
    boxes = Boxes2D(
        stack_columns(table, BOX),
        table["score"].to_numpy(),
        class_indices(table),
        stack_columns(table, AMODAL_BOX),
        stack_columns(table, AMODAL_SD),
    )
    detected = {FrameKey(str(camera_id), local_ns): _NONE for local_ns, camera_id in empty}
    start = 0
    for key, rows in groupby(zip(table["camera_id"].to_pylist(), table["local_ns"].to_pylist(), strict=True)):
        of_frame = slice(start, start + sum(1 for _ in rows))
        detected[FrameKey(*key)] = Boxes2D._make(column[of_frame] for column in boxes)
        start = of_frame.stop
    return {frame: detected[frame] for frame in sorted(detected)}
