"""2D boxes and the multi-view vehicles found among them: one Parquet file, one row per box.

A frame without a box has one row whose ``index`` is −1, so that "seen nothing" and "no frame" stay apart.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from wibam_core.formats.detections import AMODAL_BOX, AMODAL_SD, BOX
from wibam_core.formats.tables import class_named
from wibam_core.road_users import CLASSES
from wibam_core.scene import AnnotatedInstant, Detections2D, MultiViewVehicle

SCHEMA = pa.schema(
    [
        ("time_ns", pa.int64()),
        ("camera_id", pa.string()),
        ("frame_time_ns", pa.int64()),
        ("index", pa.int32()),
        *((name, pa.float64()) for name in BOX),
        ("score", pa.float64()),
        ("class", pa.string()),
        # around the whole vehicle, hidden parts included, and standard deviations; null where unknown
        *((name, pa.float64()) for name in (*AMODAL_BOX, *AMODAL_SD)),
        # of the multi-view vehicle that the box belongs to; null where it belongs to none
        ("obj_id", pa.int32()),
        ("track_id", pa.int32()),
        ("vehicle_class", pa.string()),
        ("vehicle_x_m", pa.float64()),
        ("vehicle_y_m", pa.float64()),
    ]
)


def write_annotations(path: Path, instants: Iterable[AnnotatedInstant]) -> None:
    """Write instants, sorted by time."""
    columns: dict[str, list[Any]] = {name: [] for name in SCHEMA.names}

    def row(**values: Any) -> None:
        for name in SCHEMA.names:
            columns[name].append(values.get(name))

    for instant in sorted(instants, key=lambda i: i.time_ns):
        owner = {(camera, i): v for v in instant.vehicles for camera, i in v.views.items()}
        for camera_id, seen in instant.detections.items():
            frame = {"time_ns": instant.time_ns, "camera_id": camera_id, "frame_time_ns": seen.frame_time_ns}
            if not len(seen):
                row(**frame, index=-1)
            for i in range(len(seen)):
                vehicle = owner.get((camera_id, i))
                amodal = np.concatenate([seen.amodal_boxes[i], seen.amodal_sd[i]])
                row(
                    **frame,
                    index=i,
                    **dict(zip(BOX, seen.boxes[i].tolist(), strict=True)),
                    **(
                        dict(zip((*AMODAL_BOX, *AMODAL_SD), amodal.tolist(), strict=True))
                        if np.isfinite(amodal).all()
                        else {}
                    ),
                    score=float(seen.scores[i]),
                    **{"class": CLASSES[seen.classes[i]].value},
                    **(
                        {}
                        if vehicle is None
                        else {
                            "obj_id": vehicle.obj_id,
                            "track_id": vehicle.track_id,
                            "vehicle_class": vehicle.vehicle_class.value,
                            "vehicle_x_m": vehicle.x_m,
                            "vehicle_y_m": vehicle.y_m,
                        }
                    ),
                )
    pq.write_table(pa.table(columns, schema=SCHEMA), path, compression="zstd")


def read_annotations(path: Path) -> list[AnnotatedInstant]:
    """Read what `write_annotations` wrote, sorted by time.

    Raises:
        InputError: it names a class that is not in the catalogue.
    """
    rows = pq.read_table(path, schema=SCHEMA).to_pylist()
    return [_instant(time_ns, list(group)) for time_ns, group in groupby(rows, key=lambda r: r["time_ns"])]


def _instant(time_ns: int, rows: list[dict[str, Any]]) -> AnnotatedInstant:
    detections: dict[str, Detections2D] = {}
    vehicles: dict[int, MultiViewVehicle] = {}
    views: dict[int, dict[str, int]] = {}
    for camera_id, group in groupby(rows, key=lambda r: r["camera_id"]):
        frame = list(group)
        boxes = [r for r in frame if r["index"] >= 0]
        detections[camera_id] = Detections2D(
            camera_id,
            frame[0]["frame_time_ns"],
            np.array([[r[name] for name in BOX] for r in boxes]),
            np.array([r["score"] for r in boxes]),
            np.array([class_named(r["class"]).number for r in boxes], dtype=np.int64),
            *(
                np.array([[r[name] for name in names] for r in boxes], dtype=np.float64)
                for names in (AMODAL_BOX, AMODAL_SD)
            ),
        )
        for r in boxes:
            if r["obj_id"] is None:
                continue
            views.setdefault(r["obj_id"], {})[camera_id] = r["index"]
            vehicles[r["obj_id"]] = MultiViewVehicle(
                r["obj_id"],
                r["track_id"],
                class_named(r["vehicle_class"]),
                r["vehicle_x_m"],
                r["vehicle_y_m"],
                views[r["obj_id"]],
            )
    return AnnotatedInstant(time_ns, detections, tuple(vehicles[i] for i in sorted(vehicles)))
