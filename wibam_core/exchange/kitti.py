"""KITTI object labels and results: per camera and frame a text file (Geiger et al. 2012; the devkit's readme).

::

    <camera id>/label_2/000000.txt   labels: type, truncated, occluded, alpha, left, top, right, bottom,
                                     height, width, length, x, y, z, rotation_y
    <camera id>/data/000000.txt      results: the same, and a score
    <camera id>/calib/000000.txt     P2 = K [I|0]; Tr_velo_to_cam; S_rect_02: width and height, as KITTI's raw data has
    <camera id>/times.txt            a line a frame, s, as KITTI's odometry data has

Locations are middles of the bottom in the camera's frame (m); a box is turned about the camera's y axis by
``rotation_y`` from x, so that its heading there is (cos, 0, −sin). ``Tr_velo_to_cam`` is T_cam_world: our world has the
place of the velodyne's frame. Of data sets by the roadside that have ``denorm/000000.txt`` instead, the plane
a x + b y + c z + d = 0 of the ground in the camera's frame, the world has its origin below the camera and X along its
view.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from wibam_core.errors import InputError
from wibam_core.exchange.base import CAMERA_ID, Content, Part, require_parts
from wibam_core.exchange.files import image_size_px, read_text, within, wrong
from wibam_core.exchange.names import classes_by_name
from wibam_core.geometry.box3d import HEIGHT, LENGTH, WIDTH, XYZ, YAW
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import project_boxes
from wibam_core.geometry.se3 import SE3, normalise_angle
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import CameraRig, FloatArray, IntArray, LabelledInstant, Vehicles3D

_LABELS, _RESULTS = "label_2", "data"
_NAME = "{:06d}"
_MOST_BYTES = 1 << 20
#: Visibility from which a vehicle is as little hidden as KITTI's 0, 1 and 2 say, and the middle of each step.
_OCCLUDED = ((0.8, 0.9), (0.4, 0.6), (0.0, 0.2))
#: What KITTI writes of a vehicle of which it is not known how far it is hidden.
_UNKNOWN_OCCLUSION = 3
#: KITTI's pictures have no times of their own: ten a second.
_USUAL_PERIOD_NS = 100_000_000
#: How much the numbers of one camera's calibration files may differ, relatively: they are written with 12 digits.
_SAME = 1e-6


class Kitti:
    """See this module."""

    name = "kitti"
    title = "KITTI object labels and results"
    needs = frozenset({Part.CALIBRATION})
    writes = frozenset({Part.CALIBRATION, Part.BOXES_3D, Part.LABELS})
    reads = frozenset({Part.CALIBRATION, Part.BOXES_3D, Part.LABELS})
    loses = (
        "Identities, standard deviations, tracks, the lens's distortion, frames' own times of exposure, what no camera "
        "sees, and classes that KITTI lacks (a bus is Misc). Visibility has three steps. KITTI's boxes are upright for "
        "a level camera: of a pitched one, whoever does not know the ground turns boxes about the camera's y axis, and "
        "tilts them by the pitch."
    )

    def write(self, content: Content, folder: Path) -> Sequence[Path]:
        """Write labels and 3D boxes, as far as they are there, of every camera that sees them.

        Raises:
            InputError: neither are there, or no calibration.
        """
        require_parts(self, content)
        if content.rig is None or (content.labels is None and content.boxes_3d is None):
            raise InputError(
                f"{self.title} needs labels or boxes 3d, which are not there",
                hint="Let the job run up to the stage that makes them.",
            )
        labels = {instant.vehicles.time_ns: instant for instant in content.labels or ()}
        boxes_3d: dict[int, list[Vehicles3D]] = {}
        for vehicles in content.boxes_3d or ():
            boxes_3d.setdefault(vehicles.time_ns, []).append(vehicles)
        times = sorted(labels.keys() | boxes_3d.keys())
        paths: list[Path] = []
        for camera_id, camera in content.rig.items():
            of_camera = folder / camera_id
            files: dict[str, list[str]] = {"times.txt": [f"{time * 1e-9:.9f}" for time in times]}
            for n, time_ns in enumerate(times):
                files[f"calib/{_NAME.format(n)}.txt"] = _calibration_lines(camera)
                for kind, of_kind in (
                    (_LABELS, None if content.labels is None else _labels_of(labels.get(time_ns), camera_id)),
                    (_RESULTS, None if content.boxes_3d is None else _boxes_of(boxes_3d.get(time_ns, []), camera_id)),
                ):
                    if of_kind is not None:
                        files[f"{kind}/{_NAME.format(n)}.txt"] = list(_lines(camera, *of_kind, kind == _RESULTS))
            for name, lines in files.items():
                path = of_camera / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
                paths.append(path)
        return paths

    def read(self, path: Path) -> Content:
        """Read the folder of one camera, or one that holds several.

        Results of a camera are boxes that it saw alone; labels of several cameras at one time are put together, where
        they are equal to a centimetre. Types that are no road users of ours, and boxes without a size, are left out,
        and noted.
        """
        folders = [path] if (path / "calib").is_dir() else sorted(p.parent for p in path.glob("*/calib") if p.is_dir())
        if not folders:
            raise InputError(
                f"{path.name} holds no KITTI data set", hint="Give the folder with calib/, or the one above several."
            )
        cameras: dict[str, Camera] = {}
        notes: Counter[str] = Counter()
        labels: dict[int, list[_Seen]] = {}
        results: list[Vehicles3D] = []
        kinds = set()
        for folder in folders:
            if not CAMERA_ID.fullmatch(folder.name):
                raise InputError(f"{folder.name!r} is no camera id", hint="Name it by letters, digits, - and _.")
            frames = _frames(folder)
            cameras[folder.name] = camera = _camera(folder, [name for name, _ in frames])
            for name, time_ns in frames:
                for kind in (_LABELS, _RESULTS):
                    file = folder / kind / f"{name}.txt"
                    if not file.is_file():
                        continue
                    kinds.add(kind)
                    seen = _read_file(file, camera, notes)
                    if kind == _LABELS:
                        labels.setdefault(time_ns, []).append(replace(seen, camera_id=folder.name))
                    else:
                        results.append(
                            Vehicles3D.of(time_ns, seen.boxes, seen.classes, scores=seen.scores, camera_id=folder.name)
                        )
        return Content(
            rig=CameraRig(cameras),
            labels=[_together(time, labels[time]) for time in sorted(labels)] if _LABELS in kinds else None,
            boxes_3d=sorted(results, key=lambda v: (v.time_ns, v.camera_id or "")) if _RESULTS in kinds else None,
            notes=tuple(f"{n} boxes {what} were left out" for what, n in sorted(notes.items())),
        )


@dataclass(frozen=True, eq=False)
class _Seen:
    """Boxes (N, 7) in the world as one camera's file has them; ``visibility`` (N,) is NaN for results."""

    boxes: FloatArray
    classes: IntArray
    scores: FloatArray
    visibility: FloatArray
    camera_id: str = field(default="")


# --- out -----------------------------------------------------------------------------------------------------------
def _labels_of(instant: LabelledInstant | None, camera_id: str) -> tuple[Vehicles3D, FloatArray]:
    """The labels of an instant that a camera sees, and how much of each."""
    if instant is None:
        return _nothing(), np.empty(0)
    visibility = np.asarray(instant.visibility.get(camera_id, np.zeros(len(instant.vehicles))), dtype=np.float64)
    return instant.vehicles.where(visibility > 0), visibility[visibility > 0]


def _boxes_of(vehicles: Iterable[Vehicles3D], camera_id: str) -> tuple[Vehicles3D, FloatArray]:
    """Boxes of this camera's images or of none; how much is seen of them is not known."""
    found = [_nothing(), *(v for v in vehicles if v.camera_id in (None, camera_id))]
    parts = [np.concatenate([getattr(v, name) for v in found]) for name in ("boxes", "classes", "scores")]
    joined = Vehicles3D.of(found[-1].time_ns, parts[0], parts[1], scores=parts[2])
    return joined, np.full(len(joined), np.nan)


def _nothing() -> Vehicles3D:
    return Vehicles3D.of(0, np.empty((0, 7)))


def _calibration_lines(camera: Camera) -> list[str]:
    """KITTI's file. There is one camera instead of four: all P are its own."""
    P = np.concatenate([camera.K, np.zeros((3, 1))], axis=1)
    eye = np.eye(3, 4)
    rows = {
        **{f"P{i}": P for i in range(4)},
        "R0_rect": np.eye(3),
        "Tr_velo_to_cam": camera.T_cam_world.matrix[:3],
        "Tr_imu_to_velo": eye,
        "S_rect_02": np.array([camera.width_px, camera.height_px]),
    }
    return [f"{name}: {' '.join(f'{value:.12e}' for value in matrix.ravel())}" for name, matrix in rows.items()]


def _lines(camera: Camera, vehicles: Vehicles3D, visibility: FloatArray, scored: bool) -> Iterator[str]:
    shown, whole = project_boxes(camera, vehicles.boxes), project_boxes(camera, vehicles.boxes, clamp=False)
    for i, box in enumerate(vehicles.boxes):
        name = CLASSES[vehicles.classes[i]].traits.elsewhere.kitti.written
        if name is None or not np.isfinite(shown[i]).all():
            continue
        bottom = camera.to_camera(box[XYZ] - [0, 0, box[HEIGHT] / 2])
        rotation_y = _rotation_y(camera, float(box[YAW]))
        alpha = float(normalise_angle(rotation_y - np.arctan2(bottom[0], bottom[2])))
        truncated = 1 - _area(shown[i]) / _area(whole[i])
        numbers = [*shown[i], box[HEIGHT], box[WIDTH], box[LENGTH], *bottom, rotation_y]
        yield (
            f"{name} {truncated:.2f} {_occluded(float(visibility[i]))} {alpha:.4f} "
            + " ".join(f"{value:.4f}" for value in numbers)
            + (f" {vehicles.scores[i]:.4f}" if scored else "")
        )


def _rotation_y(camera: Camera, yaw_rad: float) -> float:
    """The heading's shadow along the camera's y axis, as an angle about it from x."""
    heading = camera.T_cam_world.rotate([np.cos(yaw_rad), np.sin(yaw_rad), 0.0])
    return float(np.arctan2(-heading[2], heading[0]))


def _yaw(camera: Camera, rotation_y: float) -> float:
    """The inverse of `_rotation_y`: of the directions on the ground, the one with this shadow."""
    up = camera.T_cam_world.rotate([0.0, 0.0, 1.0])
    x, z = np.cos(rotation_y), -np.sin(rotation_y)
    heading = camera.T_world_cam.rotate([x, -(up[0] * x + up[2] * z) / up[1], z])
    return float(np.arctan2(heading[1], heading[0]))


def _area(box: FloatArray) -> float:
    return float((box[2] - box[0]) * (box[3] - box[1]))


def _occluded(visibility: float) -> int:
    if np.isnan(visibility):
        return _UNKNOWN_OCCLUSION
    return next(step for step, (least, _) in enumerate(_OCCLUDED) if visibility > least or least == 0.0)


# --- in ------------------------------------------------------------------------------------------------------------
def _frames(folder: Path) -> list[tuple[str, int]]:
    """Names and times (ns) of all frames that have a calibration, in order."""
    names = sorted(path.stem for path in (folder / "calib").glob("*.txt"))
    if not names or not all(name.isascii() and name.isdecimal() and len(name) <= 9 for name in names):
        raise InputError(f"{folder.name}/calib holds no files named by numbers", hint="KITTI counts: 000000.txt.")
    times = folder / "times.txt"
    if not times.is_file():
        return [(name, int(name) * _USUAL_PERIOD_NS) for name in names]
    try:
        seconds = [float(line) for line in read_text(times).split()]
        found = [(name, round(seconds[int(name)] * 1e9)) for name in names]
    except (ValueError, OverflowError, IndexError) as error:
        raise wrong(times, "seconds", "a number is needed for every frame") from error
    if (np.diff([time for _, time in found]) <= 0).any():
        raise wrong(times, "seconds", "times must increase")
    return found


def _camera(folder: Path, names: Sequence[str]) -> Camera:
    """The one camera of all calibration files.

    Raises:
        InputError: they differ, or do not say what a camera is.
    """
    first: dict[str, FloatArray] = {}
    for name in names:
        said = _read_calibration(folder / "calib" / f"{name}.txt")
        if name == names[0]:
            first = said
        elif said.keys() != first.keys() or not all(
            np.shape(said[key]) == np.shape(first[key]) and np.allclose(said[key], first[key], rtol=_SAME, atol=_SAME)
            for key in first
        ):
            raise wrong(
                folder / "calib" / f"{name}.txt", "P2", f"the calibration is not that of {names[0]}: the camera moves"
            )
    path = folder / "calib" / f"{names[0]}.txt"
    P = _matrix(path, first, "P2", (3, 4))
    if "Tr_velo_to_cam" in first:
        rectified = SE3.from_matrix(np.eye(4))
        T_cam_world = _transform(path, "Tr_velo_to_cam", _matrix(path, first, "Tr_velo_to_cam", (3, 4)))
        if "R0_rect" in first:
            rotation = np.concatenate([_matrix(path, first, "R0_rect", (3, 3)), np.zeros((3, 1))], axis=1)
            rectified = _transform(path, "R0_rect", rotation)
        T_world_cam = (rectified @ T_cam_world).inverse()
    else:
        T_world_cam = _above_ground(folder / "denorm" / f"{names[0]}.txt")
    # the fourth column moves the camera along its axes: P2 = K [I | K^-1 p4]
    try:
        shift: FloatArray = np.linalg.solve(P[:, :3], P[:, 3]).astype(np.float64)
        T_world_cam = T_world_cam @ SE3(np.eye(3), shift).inverse()
        return Camera(P[:, :3], np.zeros(0), T_world_cam, *_size(folder, names[0], path, first))
    except (ValueError, np.linalg.LinAlgError) as error:
        raise wrong(path, "P2", str(error)) from error


def _read_calibration(path: Path) -> dict[str, FloatArray]:
    said = {}
    for line in read_text(path, _MOST_BYTES).splitlines():
        name, colon, numbers = line.partition(":")
        if not colon:
            continue
        try:
            said[name.strip()] = np.array([float(number) for number in numbers.split()])
        except ValueError as error:
            raise wrong(path, name.strip()[:50], "numbers are needed") from error
    return said


def _matrix(path: Path, said: Mapping[str, FloatArray], name: str, shape: tuple[int, int]) -> FloatArray:
    values = said.get(name, np.empty(0))
    if values.size != shape[0] * shape[1] or not np.isfinite(values).all():
        raise wrong(path, name, f"{shape[0] * shape[1]} finite numbers are needed")
    return values.reshape(shape)


def _transform(path: Path, name: str, matrix: FloatArray) -> SE3:
    try:
        return SE3.from_matrix(matrix)
    except ValueError as error:
        raise wrong(path, name, str(error)) from error


def _above_ground(path: Path) -> SE3:
    """The pose of a camera (T_world_cam) of which only the plane of the ground is known."""
    if not path.is_file():
        raise InputError(
            f"neither Tr_velo_to_cam in calib/{path.name} nor denorm/{path.name} says where the ground lies",
            hint="Add one of them: labels stand on the ground.",
        )
    try:
        *normal, offset = (float(value) for value in read_text(path, _MOST_BYTES).split())
        length = float(np.linalg.norm(normal))
        up: FloatArray = np.array(normal, dtype=np.float64) / length
        ahead = np.array([0.0, 0.0, 1.0]) - up[2] * up
        forward: FloatArray = ahead / np.linalg.norm(ahead)
        return SE3(np.stack([forward, np.cross(up, forward), up]), np.array([0.0, 0.0, offset / length]))
    except (ValueError, ZeroDivisionError, IndexError) as error:
        raise wrong(path, "plane", "four numbers a b c d of the plane are needed, that is no wall") from error


def _size(folder: Path, name: str, path: Path, said: Mapping[str, FloatArray]) -> tuple[int, int]:
    if "S_rect_02" in said:
        width, height = _matrix(path, said, "S_rect_02", (1, 2))[0]
        return int(width), int(height)
    for suffix in ("png", "jpg"):
        image = within(folder, f"image_2/{name}.{suffix}")
        if image.is_file():
            return image_size_px(image)
    raise wrong(path, "S_rect_02", "the size of the images is not known", "Add it, or image_2/ with the images.")


def _read_file(path: Path, camera: Camera, notes: Counter[str]) -> _Seen:
    known = {name.lower(): c for name, c in classes_by_name(lambda names: names.kitti).items()}
    rows: list[tuple[RoadUserClass, FloatArray]] = []
    for number, line in enumerate(read_text(path, _MOST_BYTES).splitlines(), 1):
        words = line.split()
        if not words:
            continue
        try:
            values = np.array([float(word) for word in words[1:]])
        except ValueError as error:
            raise wrong(path, f"line {number}", "after the type, numbers are needed") from error
        if len(values) not in (14, 15) or not np.isfinite(values).all():
            raise wrong(path, f"line {number}", f"14 finite numbers are needed, or 15 with a score, not {len(values)}")
        if words[0].lower() not in known:
            notes[f"of type {words[0][:50]}"] += 1
        elif (values[7:10] <= 0).any():
            notes["without a size"] += 1
        else:
            rows.append((known[words[0].lower()], values))
    boxes = np.array([_to_box(camera, values) for _, values in rows]).reshape(-1, 7)
    scores = np.clip([values[14] if len(values) > 14 else 1.0 for _, values in rows], 0.0, 1.0)
    visibility = np.array([_visibility(int(values[1])) for _, values in rows])
    return _Seen(boxes, np.array([c.number for c, _ in rows], np.int64), scores, visibility)


def _to_box(camera: Camera, values: FloatArray) -> FloatArray:
    height, width, length = values[7:10]
    x, y, z = camera.T_world_cam.apply(values[10:13])
    return np.array([x, y, z + height / 2, length, width, height, _yaw(camera, float(values[13]))])


def _visibility(occluded: int) -> float:
    return _OCCLUDED[occluded][1] if 0 <= occluded < len(_OCCLUDED) else 1.0


def _together(time_ns: int, seen: Sequence[_Seen]) -> LabelledInstant:
    """Labels of several cameras at one time; those at the same place are one vehicle's."""
    boxes: list[FloatArray] = []
    classes: list[int] = []
    visibility: list[dict[str, float]] = []
    for of_camera in seen:
        for box, c, share in zip(of_camera.boxes, of_camera.classes.tolist(), of_camera.visibility, strict=True):
            same = [k for k, other in enumerate(boxes) if c == classes[k] and np.abs(other - box)[:6].max() < 0.01]
            if same:
                visibility[same[0]][of_camera.camera_id] = float(share)
            else:
                boxes.append(box)
                classes.append(c)
                visibility.append({of_camera.camera_id: float(share)})
    return LabelledInstant(
        Vehicles3D.of(time_ns, np.array(boxes).reshape(-1, 7), np.array(classes, np.int64)),
        {s.camera_id: np.array([v.get(s.camera_id, 0.0) for v in visibility]) for s in seen},
    )
