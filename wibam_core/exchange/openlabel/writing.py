"""Writing of OpenLABEL scenes."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from wibam_core.exchange.base import Content, Part
from wibam_core.exchange.openlabel.document import WORLD
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import (
    AnnotatedInstant,
    CameraRig,
    Detections2D,
    FloatArray,
    LabelledInstant,
    Track,
    Vehicles3D,
)

#: The schema asks for five coefficients or more.
_LEAST_COEFFICIENTS = 5

#: An object in a frame: its number, class and object data.
_Seen = tuple[int, RoadUserClass, dict[str, Any]]
#: A frame: its properties, and its objects.
_Frame = tuple[dict[str, Any], Sequence[_Seen]]


def write_scenes(content: Content, rig: CameraRig, folder: Path) -> list[Path]:
    """Write a file for each part that is there, or for the calibration alone."""
    frames: dict[Part, Iterable[_Frame]] = {}
    if content.tracks is not None:
        frames[Part.TRACKS] = _track_frames(content.tracks)
    if content.boxes_3d is not None:
        frames[Part.BOXES_3D] = _box_frames(content.boxes_3d)
    if content.labels is not None:
        frames[Part.LABELS] = _label_frames(content.labels)
    if content.instants is not None:
        frames[Part.BOXES_2D] = _image_frames(content, content.instants)
    paths = []
    for part, made in (frames or {Part.CALIBRATION: ()}).items():
        paths.append(folder / f"openlabel_{part.value}.json")
        _write_scene(paths[-1], content, rig, part, made)
    return paths


def _write_scene(path: Path, content: Content, rig: CameraRig, part: Part, frames: Iterable[_Frame]) -> None:
    """Write frame by frame, and then the objects, which only then are known."""
    head = {
        "metadata": {
            "schema_version": "1.0.0",
            "name": content.site.name if content.site else "",
            "wibam_part": part.value,
        },
        "coordinate_systems": _coordinate_systems(rig),
        "streams": _streams(rig),
    }
    where: dict[int, list[int]] = {}
    classes: dict[int, Counter[RoadUserClass]] = {}
    with path.open("w", encoding="utf-8") as file:
        file.write('{"openlabel": ' + json.dumps(head, allow_nan=False)[:-1] + ',\n"frames": {')
        for number, (properties, seen) in enumerate(frames):
            objects = {}
            for uid, road_user, data in seen:
                objects[str(uid)] = {"object_data": data}
                where.setdefault(uid, []).append(number)
                classes.setdefault(uid, Counter())[road_user] += 1
            frame = {"frame_properties": properties, "objects": objects}
            file.write(f'{"," if number else ""}\n"{number}": {json.dumps(frame, allow_nan=False)}')
        objects = {str(uid): _object(uid, classes[uid].most_common(1)[0][0], numbers) for uid, numbers in where.items()}
        file.write('},\n"objects": ' + json.dumps(objects) + "}}\n")


def _object(uid: int, road_user: RoadUserClass, frames: Sequence[int]) -> dict[str, Any]:
    known = set(frames)
    starts = [n for n in frames if n - 1 not in known]
    ends = [n for n in frames if n + 1 not in known]
    name = str(road_user.traits.elsewhere.openlabel.written)
    return {
        "name": f"{name}_{uid}",
        "type": name,
        "frame_intervals": [{"frame_start": a, "frame_end": b} for a, b in zip(starts, ends, strict=True)],
    }


def _coordinate_systems(rig: CameraRig) -> dict[str, Any]:
    cameras = {
        camera_id: {
            "type": "sensor_cs",
            "parent": WORLD,
            "children": [],
            "pose_wrt_parent": {"matrix4x4": camera.T_world_cam.matrix.ravel().tolist()},
        }
        for camera_id, camera in rig.items()
    }
    return {WORLD: {"type": "scene_cs", "parent": "", "children": list(rig)}, **cameras}


def _streams(rig: CameraRig) -> dict[str, Any]:
    return {
        camera_id: {
            "type": "camera",
            "stream_properties": {
                "intrinsics_pinhole": {
                    "camera_matrix": np.hstack([camera.K, np.zeros((3, 1))]).ravel().tolist(),
                    "distortion_coeffs": np.pad(
                        camera.dist, (0, max(0, _LEAST_COEFFICIENTS - camera.dist.size))
                    ).tolist(),
                    "width_px": camera.width_px,
                    "height_px": camera.height_px,
                }
            },
        }
        for camera_id, camera in rig.items()
    }


def _times(time_ns: int) -> dict[str, Any]:
    return {"timestamp": time_ns * 1e-9, "time_ns": time_ns}


def _track_frames(tracks: Sequence[Track]) -> Iterator[_Frame]:
    there: dict[int, list[tuple[Track, int]]] = {}
    for track in tracks:
        for i, time_ns in enumerate(track.times_ns.tolist()):
            there.setdefault(time_ns, []).append((track, i))
    for time_ns, states in sorted(there.items(), key=lambda item: item[0]):
        yield (
            _times(time_ns),
            [
                (
                    track.track_id,
                    track.vehicle_class,
                    _cuboid(
                        track.boxes[i],
                        track.sd[i],
                        track.vehicle_class,
                        num={"yaw_rate": float(track.yaw_rates_radps[i])},
                        vec={"velocity": [*track.velocities_mps[i].tolist(), 0.0]},
                    ),
                )
                for track, i in states
            ],
        )


def _box_frames(instants: Sequence[Vehicles3D]) -> Iterator[_Frame]:
    unfollowed = count(-1, -1)
    for vehicles in instants:
        whose = {} if vehicles.camera_id is None else {"camera_id": vehicles.camera_id}
        yield {**_times(vehicles.time_ns), **whose}, _vehicles(vehicles, unfollowed)


def _label_frames(instants: Sequence[LabelledInstant]) -> Iterator[_Frame]:
    unfollowed = count(-1, -1)
    for label in instants:
        yield _times(label.vehicles.time_ns), _vehicles(label.vehicles, unfollowed, label.visibility)


def _vehicles(
    vehicles: Vehicles3D, unfollowed: Iterator[int], visibility: Mapping[str, FloatArray] | None = None
) -> list[_Seen]:
    seen = []
    for i, uid in enumerate(vehicles.ids.tolist()):
        road_user = CLASSES[vehicles.classes[i]]
        shares = {f"visibility_{camera_id}": float(shares[i]) for camera_id, shares in (visibility or {}).items()}
        cuboid = _cuboid(
            vehicles.boxes[i], vehicles.sd[i], road_user, num={"score": float(vehicles.scores[i]), **shares}
        )
        seen.append((uid if uid >= 0 else next(unfollowed), road_user, cuboid))
    return seen


def _cuboid(
    box: FloatArray,
    sd: FloatArray,
    road_user: RoadUserClass,
    num: Mapping[str, float],
    vec: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> dict[str, Any]:
    """Object data of a box (7,) with standard deviations (7,), and numbers and vectors by name."""
    x, y, z, length, width, height, yaw = box.tolist()
    vectors = {**vec, "sd": sd.tolist()} if np.isfinite(sd).all() else vec
    return {
        "cuboid": [
            {
                "name": "shape3D",
                "coordinate_system": WORLD,
                "val": [x, y, z, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2), length, width, height],
                "attributes": _attributes(road_user, num, vectors),
            }
        ]
    }


def _image_frames(content: Content, instants: Sequence[AnnotatedInstant]) -> Iterator[_Frame]:
    unfollowed = count(-1, -1)
    for instant in instants:
        streams = {
            camera_id: {
                "uri": content.image_name(camera_id, seen.frame_time_ns),
                "stream_properties": {
                    "sync": {"timestamp": seen.frame_time_ns * 1e-9},
                    "time_ns": seen.frame_time_ns,
                },
            }
            for camera_id, seen in instant.detections.items()
        }
        associated = {(c, i) for vehicle in instant.vehicles for c, i in vehicle.views.items()}
        seen_here: list[_Seen] = [
            (
                vehicle.track_id if vehicle.track_id >= 0 else next(unfollowed),
                vehicle.vehicle_class,
                {
                    "bbox": [_bbox(instant.detections[c], i) for c, i in vehicle.views.items()],
                    "text": [{"name": "type", "val": vehicle.vehicle_class.traits.elsewhere.openlabel.written}],
                    "num": [{"name": "obj_id", "val": vehicle.obj_id}],
                    "vec": [{"name": "ground", "val": [vehicle.x_m, vehicle.y_m]}],
                },
            )
            for vehicle in instant.vehicles
        ]
        for camera_id, seen in instant.detections.items():
            seen_here += [
                (next(unfollowed), CLASSES[number], {"bbox": [_bbox(seen, i)]})
                for i, number in enumerate(seen.classes.tolist())
                if (camera_id, i) not in associated
            ]
        yield {**_times(instant.time_ns), "streams": streams}, seen_here


def _bbox(seen: Detections2D, index: int) -> dict[str, Any]:
    x0, y0, x1, y1 = seen.boxes[index].tolist()
    return {
        "name": f"full_bbox_{seen.camera_id}",
        "coordinate_system": seen.camera_id,
        "val": [(x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0],
        "attributes": _attributes(CLASSES[seen.classes[index]], {"score": float(seen.scores[index])}, {}),
    }


def _attributes(
    road_user: RoadUserClass, num: Mapping[str, float], vec: Mapping[str, Sequence[float]]
) -> dict[str, Any]:
    return {
        "text": [{"name": "type", "val": road_user.traits.elsewhere.openlabel.written}],
        "num": [{"name": name, "val": value} for name, value in num.items()],
        "vec": [{"name": name, "val": list(values)} for name, values in vec.items()],
    }
