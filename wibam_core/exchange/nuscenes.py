"""nuScenes detection results: one JSON file of 3D boxes by sample
(https://github.com/nutonomy/nuscenes-devkit, python-sdk/nuscenes/eval/detection).

A sample is an instant, or one camera's frame of it where a network looked at that frame alone; its token is
``<time in ns>``, or ``<camera id>/<time in ns>``. Boxes stand in the global frame, which is our world: ``translation``
is the centre (m), ``size`` width, length, height (m), ``rotation`` the quaternion w, x, y, z of a turn about the
vertical from x forward.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from wibam_core.exchange.base import Content, Part, require_parts
from wibam_core.exchange.files import read_json, wrong
from wibam_core.exchange.names import classes_by_name
from wibam_core.geometry.box3d import HEIGHT, LENGTH, WIDTH, XYZ, YAW
from wibam_core.road_users import CLASSES
from wibam_core.scene import FloatArray, Track, Vehicles3D

_FILE = "results_nusc.json"
#: The devkit refuses samples with more.
_MOST_BOXES = 500

_Three = tuple[float, float, float]


class _Box(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    translation: _Three
    size: _Three
    rotation: tuple[float, float, float, float]
    detection_name: str = Field(max_length=100)
    detection_score: float = Field(ge=0, le=1)


class _Results(BaseModel):
    results: dict[str, tuple[_Box, ...]]


class NuScenesResults:
    """See this module."""

    name = "nuscenes-results"
    title = "nuScenes detection results"
    needs = frozenset({Part.BOXES_3D})
    writes = frozenset({Part.BOXES_3D})
    reads = frozenset({Part.BOXES_3D})
    loses = (
        "Identities, standard deviations, the calibration, tracks and 2D boxes, and what tells classes apart that "
        f"nuScenes has under one name; boxes beyond the {_MOST_BOXES} surest of a sample. A velocity of 0 stands where "
        "none is known."
    )

    def write(self, content: Content, folder: Path) -> Sequence[Path]:
        """Write ``results_nusc.json``. Velocities are those of the content's tracks at the same time."""
        require_parts(self, content)
        velocities = _velocities(content.tracks or ())
        results: dict[str, list[dict[str, Any]]] = {}
        for vehicles in content.boxes_3d or ():
            token = str(vehicles.time_ns) if vehicles.camera_id is None else f"{vehicles.camera_id}/{vehicles.time_ns}"
            results.setdefault(token, []).extend(_boxes(token, vehicles, velocities))
        for boxes in results.values():
            boxes.sort(key=lambda box: -box["detection_score"])
            del boxes[_MOST_BOXES:]
        sensors = {f"use_{sensor}": sensor == "camera" for sensor in ("camera", "lidar", "radar", "map", "external")}
        path = folder / _FILE
        path.write_text(json.dumps({"meta": sensors, "results": results}, allow_nan=False), encoding="utf-8")
        return [path]

    def read(self, path: Path) -> Content:
        """Read a JSON file, or the ``results_nusc.json`` of a folder.

        Of a box that does not stand upright, the heading on the ground is taken.
        """
        path = path / _FILE if path.is_dir() else path
        document = read_json(path, _Results)
        known = classes_by_name(lambda names: names.nuscenes)
        left_out = Counter(
            box.detection_name
            for boxes in document.results.values()
            for box in boxes
            if box.detection_name not in known
        )
        found = []
        for token, boxes in document.results.items():
            camera_id, time_ns = _sample(path, token)
            kept = [box for box in boxes if box.detection_name in known]
            for n, box in enumerate(boxes):
                if min(box.size) <= 0 or not any(box.rotation):
                    raise wrong(path, f"results.{token}.{n}", "sizes must be positive, and the rotation no zero")
            found.append(
                Vehicles3D.of(
                    time_ns,
                    np.array([_to_box(box) for box in kept]),
                    np.array([known[box.detection_name].number for box in kept], np.int64),
                    scores=np.array([box.detection_score for box in kept]),
                    camera_id=camera_id,
                )
            )
        found.sort(key=lambda vehicles: (vehicles.time_ns, vehicles.camera_id or ""))
        return Content(
            boxes_3d=found,
            notes=tuple(f"{n} boxes of class {name!r} were left out" for name, n in sorted(left_out.items())),
        )


def _velocities(tracks: Sequence[Track]) -> Mapping[tuple[int, int], tuple[float, float]]:
    """(track id, ns) -> velocity along world X and Y, m/s."""
    return {
        (track.track_id, int(time)): (float(vx), float(vy))
        for track in tracks
        for time, (vx, vy) in zip(track.times_ns, track.velocities_mps, strict=True)
    }


def _boxes(
    token: str, vehicles: Vehicles3D, velocities: Mapping[tuple[int, int], tuple[float, float]]
) -> list[dict[str, Any]]:
    written = [c.traits.elsewhere.nuscenes.written for c in CLASSES]
    return [
        {
            "sample_token": token,
            "translation": box[XYZ].tolist(),
            "size": box[[WIDTH, LENGTH, HEIGHT]].tolist(),
            "rotation": [float(np.cos(box[YAW] / 2)), 0.0, 0.0, float(np.sin(box[YAW] / 2))],
            "velocity": list(velocities.get((int(vehicles.ids[i]), vehicles.time_ns), (0.0, 0.0))),
            "detection_name": written[vehicles.classes[i]],
            "detection_score": float(vehicles.scores[i]),
            "attribute_name": "",
        }
        for i, box in enumerate(vehicles.boxes)
        if written[vehicles.classes[i]] is not None
    ]


def _sample(path: Path, token: str) -> tuple[str | None, int]:
    camera_id, _, time = token.rpartition("/")
    if not time.removeprefix("-").isdecimal() or len(time) > 19:
        raise wrong(
            path,
            f"results.{token[:80]}",
            "the token does not say which instant this is",
            "Name samples <time in ns>, or <camera id>/<time in ns>: nuScenes keeps times in files of its own.",
        )
    return camera_id or None, int(time)


def _to_box(box: _Box) -> FloatArray:
    w, x, y, z = np.array(box.rotation) / np.linalg.norm(box.rotation)
    width, length, height = box.size
    # the x axis turned by the quaternion, seen from above
    yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return np.array([*box.translation, length, width, height, yaw])
