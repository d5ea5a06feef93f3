"""Reading of OpenLABEL scenes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wibam_core.errors import InputError
from wibam_core.exchange import motion
from wibam_core.exchange.base import Content, Part
from wibam_core.exchange.files import read_json, wrong
from wibam_core.exchange.names import classes_by_name
from wibam_core.exchange.openlabel.document import (
    Attributes,
    Bbox,
    Cuboid,
    Frame,
    FrameProperties,
    ObjectData,
    Pose,
    Scene,
    SceneFile,
)
from wibam_core.geometry.box3d import XY, YAW
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import (
    AnnotatedInstant,
    CameraRig,
    Detections2D,
    FloatArray,
    LabelledInstant,
    MultiViewVehicle,
    Track,
    Vehicles3D,
)

_VISIBILITY = "visibility_"
#: Whole numbers are exact up to here in JSON.
_LARGEST_ID = 2**53
#: An object's number, where its key is no UUID.
_NUMBER = re.compile(r"-?[0-9]{1,18}")


@dataclass(frozen=True, eq=False)
class _State:
    """A cuboid in the world at a time."""

    uid: int
    time_ns: int
    road_user: RoadUserClass
    box: FloatArray
    attributes: Attributes

    @property
    def sd(self) -> list[float]:
        return self.attributes.numbers("sd", 7) or [np.nan] * 7


@dataclass
class _Gathered:
    """What all scenes hold together; ``parts`` were there, if only as an empty list."""

    parts: set[Part] = field(default_factory=set)
    cameras: dict[str, Camera] = field(default_factory=dict)
    unplaced: set[str] = field(default_factory=set)
    states: dict[int, list[_State]] = field(default_factory=dict)
    boxes: list[Vehicles3D] = field(default_factory=list)
    labels: list[LabelledInstant] = field(default_factory=list)
    instants: list[AnnotatedInstant] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)
    uuids: dict[str, int] = field(default_factory=dict)

    def number_of(self, uid: str) -> int:
        """An object's number: its own, or that of its UUID in the order of appearance."""
        return int(uid) if _NUMBER.fullmatch(uid) else self.uuids.setdefault(uid, len(self.uuids))

    def content(self) -> Content:
        """All of it, in the order of time."""
        notes = [f"{n} boxes of type {name!r} are left out." for name, n in sorted(self.left_out.items())]
        if self.unplaced:
            notes.append(f"Cameras without a pose are left out: {', '.join(sorted(self.unplaced))}.")
        return Content(
            rig=CameraRig(self.cameras) if self.cameras else None,
            instants=sorted(self.instants, key=lambda i: i.time_ns) if Part.BOXES_2D in self.parts else None,
            boxes_3d=sorted(self.boxes, key=lambda v: v.time_ns) if Part.BOXES_3D in self.parts else None,
            tracks=[_track(uid, self.states[uid]) for uid in sorted(self.states)]
            if Part.TRACKS in self.parts
            else None,
            labels=sorted(self.labels, key=lambda v: v.vehicles.time_ns) if Part.LABELS in self.parts else None,
            notes=tuple(notes),
        )


def read_scenes(path: Path) -> Content:
    """See `wibam_core.exchange.openlabel.OpenLabel.read`."""
    paths = sorted(path.glob("*.json")) if path.is_dir() else [path]
    if not paths:
        raise InputError(f"{path.name} holds no OpenLABEL file", hint="Name a JSON file, or a folder of such files.")
    gathered = _Gathered()
    for scene_path in paths:
        _SceneReader(scene_path, read_json(scene_path, SceneFile).openlabel, gathered).read()
    return gathered.content()


def _track(uid: int, states: list[_State]) -> Track:
    states = sorted(states, key=lambda state: state.time_ns)
    times_ns = np.array([state.time_ns for state in states], np.int64)
    if (np.diff(times_ns) == 0).any():
        raise InputError(f"object {uid} has two cuboids at one time", hint="Name the scenes of one recording alone.")
    boxes = np.array([state.box for state in states])
    velocities = [state.attributes.numbers("velocity", 3) for state in states]
    yaw_rates = [state.attributes.number("yaw_rate") for state in states]
    return Track(
        uid,
        Counter(state.road_user for state in states).most_common(1)[0][0],
        times_ns,
        boxes,
        np.array([state.sd for state in states]),
        np.array([v[:2] for v in velocities if v]) if all(velocities) else motion.derivative(boxes[:, XY], times_ns),
        motion.derivative(np.unwrap(boxes[:, YAW]), times_ns) if None in yaw_rates else np.array(yaw_rates, np.float64),
    )


class _SceneReader:
    """One file: adds what it holds to what is gathered."""

    def __init__(self, path: Path, scene: Scene, gathered: _Gathered) -> None:
        self._path = path
        self._scene = scene
        self._gathered = gathered
        self._classes = classes_by_name(lambda names: names.openlabel)
        self._poses: dict[str, SE3] = {}

    def read(self) -> None:
        """Cameras first, then frame by frame."""
        self._read_cameras()
        part = self._scene.metadata.wibam_part
        if part is not None:
            self._gathered.parts.add(part)
        for key, frame in self._scene.frames.items():
            where = f"frames.{key}"
            time_ns = self._time_ns(where, frame.frame_properties)
            if part is Part.BOXES_2D or any(o.object_data.bbox for o in frame.objects.values()):
                self._gathered.parts.add(Part.BOXES_2D)
                self._gathered.instants.append(self._instant(where, frame, time_ns))
            if part is Part.TRACKS:
                for state in self._states(where, frame, time_ns):
                    self._gathered.states.setdefault(state.uid, []).append(state)
            elif part is not Part.BOXES_2D:
                self._add_boxes(part, frame, time_ns, list(self._states(where, frame, time_ns)))

    def _read_cameras(self) -> None:
        for name, stream in self._scene.streams.items():
            pinhole = stream.stream_properties.intrinsics_pinhole
            if pinhole is None:
                continue
            system = self._scene.coordinate_systems.get(name)
            if system is None or (system.parent and system.pose_wrt_parent is None):
                self._gathered.unplaced.add(name)
                continue
            try:
                K = np.reshape(pinhole.camera_matrix, (3, -1))[:, :3]
                dist = np.array(pinhole.distortion_coeffs)
                camera = Camera(K, dist, self._pose(name), pinhole.width_px, pinhole.height_px)
            except ValueError as error:
                raise wrong(self._path, f"streams.{name}", str(error)) from error
            self._gathered.cameras[name] = camera

    def _pose(self, name: str) -> SE3:
        """From a coordinate system to that at its root."""
        if name not in self._poses:
            chain: list[str] = []
            while name:
                system = self._scene.coordinate_systems.get(name)
                if system is None:
                    raise wrong(self._path, f"coordinate_systems.{name}", "is named, but not declared")
                if name in chain:
                    raise wrong(self._path, f"coordinate_systems.{name}", "is its own ancestor")
                chain.append(name)
                name = system.parent
            pose = SE3.identity()
            for ancestor in reversed(chain):
                system = self._scene.coordinate_systems[ancestor]
                if system.parent:
                    pose = pose @ self._transform(ancestor, system.pose_wrt_parent)
                self._poses[ancestor] = pose
            name = chain[0]
        return self._poses[name]

    def _transform(self, name: str, pose: Pose | None) -> SE3:
        where = f"coordinate_systems.{name}.pose_wrt_parent"
        if pose is None:
            raise wrong(self._path, where, "is missing")
        try:
            if pose.matrix4x4 is not None:
                return SE3.from_matrix(np.reshape(pose.matrix4x4, (4, 4)))
            return SE3(_rotation(pose.quaternion), np.array(pose.translation))
        except ValueError as error:
            raise wrong(self._path, where, str(error)) from error

    def _time_ns(self, where: str, properties: FrameProperties) -> int:
        if properties.time_ns is not None:
            return properties.time_ns
        if properties.timestamp is None:
            raise wrong(self._path, f"{where}.frame_properties.timestamp", "is missing")
        return round(properties.timestamp * 10**9)

    def _class(self, where: str, uid: str, data: ObjectData, attributes: Attributes) -> RoadUserClass | None:
        declared = self._scene.objects.get(uid)
        name = attributes.word("type") or data.word("type") or data.type or (declared.type if declared else None)
        if name is None:
            raise wrong(self._path, f"{where}.objects.{uid}", "has no type")
        if name not in self._classes:
            self._gathered.left_out[name] += 1
        return self._classes.get(name)

    def _sensor(self, properties: FrameProperties) -> str | None:
        """The coordinate system after which a file of the frame is named."""
        names = [name for name in self._scene.coordinate_systems if name and name in properties.file_names]
        return max(names, key=len, default=None)

    def _states(self, where: str, frame: Frame, time_ns: int) -> Iterator[_State]:
        sensor = self._sensor(frame.frame_properties)
        for uid, seen in frame.objects.items():
            for cuboid in seen.object_data.cuboid:
                road_user = self._class(where, uid, seen.object_data, cuboid.attributes)
                if road_user is not None and cuboid.val is not None:
                    box = self._box(f"{where}.objects.{uid}.object_data.cuboid", cuboid, sensor)
                    yield _State(self._gathered.number_of(uid), time_ns, road_user, box, cuboid.attributes)

    def _box(self, where: str, cuboid: Cuboid, sensor: str | None) -> FloatArray:
        """(7,) in the world."""
        values = np.array(cuboid.val)
        system = cuboid.coordinate_system or sensor
        pose = self._pose(system) if system else SE3.identity()
        try:
            rotation = _rotation(values[3:7]) if len(values) == 10 else _euler(values[3:6])
        except ValueError as error:
            raise wrong(self._path, where, str(error)) from error
        forward = pose.rotate(rotation[:, 0])
        if (values[-3:] <= 0).any():
            raise wrong(self._path, where, "has a size that is not positive")
        return np.concatenate([pose.apply(values[:3]), values[-3:], [np.arctan2(forward[1], forward[0])]])

    def _add_boxes(self, part: Part | None, frame: Frame, time_ns: int, states: list[_State]) -> None:
        vehicles = Vehicles3D(
            time_ns,
            np.array([state.box for state in states]),
            np.array([state.road_user.number for state in states], np.int64),
            np.array([max(state.uid, -1) for state in states], np.int64),
            np.array([_share(state.attributes.number("score")) for state in states]),
            np.array([state.sd for state in states]),
            frame.frame_properties.camera_id,
        )
        if part is Part.LABELS:
            cameras = {n.name for state in states for n in state.attributes.num if n.name.startswith(_VISIBILITY)}
            visibility = {
                name.removeprefix(_VISIBILITY): np.array(
                    [_share(state.attributes.number(name) or 0.0) for state in states]
                )
                for name in sorted(cameras)
            }
            self._gathered.labels.append(LabelledInstant(vehicles, visibility))
        else:
            self._gathered.parts.add(Part.BOXES_3D)
            self._gathered.boxes.append(vehicles)

    def _instant(self, where: str, frame: Frame, time_ns: int) -> AnnotatedInstant:
        properties = frame.frame_properties
        found: dict[str, list[tuple[Bbox, RoadUserClass]]] = {camera_id: [] for camera_id in properties.streams}
        vehicles = []
        for uid, seen in frame.objects.items():
            data = seen.object_data
            views: dict[str, int] = {}
            for bbox in data.bbox:
                camera_id = bbox.coordinate_system or self._sensor(properties)
                if camera_id is None:
                    raise wrong(self._path, f"{where}.objects.{uid}.object_data.bbox", "names no camera")
                road_user = self._class(where, uid, data, bbox.attributes)
                if min(bbox.val[2:]) < 0:
                    raise wrong(self._path, f"{where}.objects.{uid}.object_data.bbox", "has a negative size")
                if road_user is not None:
                    views[camera_id] = len(found.setdefault(camera_id, []))
                    found[camera_id].append((bbox, road_user))
            ground, obj_id = data.numbers("ground", 2), data.number("obj_id")
            road_user = self._classes.get(data.word("type") or "")
            if obj_id is not None and abs(obj_id) > _LARGEST_ID:
                raise wrong(self._path, f"{where}.objects.{uid}.object_data.num", "is no number of a vehicle")
            if ground is not None and obj_id is not None and road_user is not None:
                track_id = max(self._gathered.number_of(uid), -1)
                vehicles.append(MultiViewVehicle(int(obj_id), track_id, road_user, ground[0], ground[1], views))
        detections = {}
        for camera_id, boxes in found.items():
            stream = properties.streams.get(camera_id)
            exposed_ns = None if stream is None else stream.stream_properties.time_ns
            detections[camera_id] = Detections2D(
                camera_id,
                time_ns if exposed_ns is None else exposed_ns,
                np.array([_xyxy(bbox.val) for bbox, _ in boxes]),
                np.array([_share(bbox.attributes.number("score")) for bbox, _ in boxes]),
                np.array([road_user.number for _, road_user in boxes], np.int64),
            )
        return AnnotatedInstant(time_ns, detections, tuple(vehicles))


def _share(score: float | None) -> float:
    """A score in [0, 1]; who states none is sure."""
    return 1.0 if score is None else min(max(score, 0.0), 1.0)


def _xyxy(values: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    x, y, width, height = values
    return x - width / 2, y - height / 2, x + width / 2, y + height / 2


def _rotation(quaternion: FloatArray | tuple[float, ...]) -> FloatArray:
    """(3, 3) of a quaternion x, y, z, w.

    Raises:
        ValueError: it has no length.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    length = np.linalg.norm(q)
    if length < 1e-6:
        raise ValueError("the quaternion has no length")
    x, y, z, w = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _euler(angles_rad: FloatArray) -> FloatArray:
    """(3, 3) of turns about x, then y, then z, the standard's default order."""
    half = angles_rad / 2
    turns = [_rotation((*(np.sin(half[axis]) * np.eye(3)[axis]), np.cos(half[axis]))) for axis in range(3)]
    return turns[2] @ turns[1] @ turns[0]
