"""The files of the WIBAM data set as our content."""

from __future__ import annotations

import math
import zipfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from wibam_core.exchange.base import Content
from wibam_core.exchange.boxes import from_corner_xywh
from wibam_core.exchange.files import MAX_IMAGE_BYTES, image_size_px, read_bytes, read_json, read_text, within, wrong
from wibam_core.exchange.names import classes_by_name
from wibam_core.exchange.wibam import hand_labels
from wibam_core.exchange.wibam.layout import PERIOD_NS, SIZE_PX, SUBSETS, Annotation, Dataset
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane
from wibam_core.geometry.se3 import SE3
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, MultiViewVehicle, site_camera
from wibam_core.site import Site

_MOST_CALIBRATION_BYTES = 1 << 20


def read(root: Path) -> Content:
    """Everything below ``root``.

    Raises:
        InputError: naming the file and the field.
    """
    file = root / "annotations" / "wibam_all.json"
    dataset = read_json(file, Dataset)
    frames, notes = _frames(file, root, dataset)
    rig = CameraRig({str(cam): _camera(root, cam, dataset) for cam in sorted({i.cam for i in dataset.images})})
    instants, left_out = _instants(file, dataset, frames, rig)
    labels, decided = hand_labels.read(
        root / "annotations" / "hand_labels", {key: f.time_ns for key, f in frames.by_number.items()}, instants, rig
    )
    images = {(str(f.cam), f.time_ns): f.name for f in frames.by_id.values()}

    def jpeg(camera_id: str, frame_time_ns: int) -> bytes:
        return read_bytes(within(root / "frames", images[camera_id, frame_time_ns]), MAX_IMAGE_BYTES)

    return Content(
        site=Site(name="WIBAM", cameras=tuple(site_camera(id_, camera) for id_, camera in rig.items())),
        rig=rig,
        instants=instants,
        labels=labels,
        images=images,
        jpeg=jpeg if (root / "frames").is_dir() else None,
        splits=_splits(root / "image_sets", frames),
        notes=(*notes, *left_out, *decided),
    )


@dataclass(frozen=True)
class _Frame:
    cam: int
    name: str
    first_id: int
    time_ns: int


@dataclass(frozen=True)
class _Frames:
    """All images, by id, and by camera and number of the frame; instants by the id of their first image."""

    by_id: Mapping[int, _Frame]
    by_number: Mapping[tuple[int, int], _Frame]
    times_ns: Mapping[int, int]


def _frames(file: Path, root: Path, dataset: Dataset) -> tuple[_Frames, list[str]]:
    numbers: dict[tuple[int, int], int] = {}
    for n, image in enumerate(dataset.images):
        stem = PurePosixPath(image.file_name).stem
        if not (stem.isascii() and stem.isdecimal() and len(stem) <= 12):
            raise wrong(file, f"images.{n}.file_name", f"{image.file_name!r} does not end in the number of a frame")
        if (image.first_id, image.cam) in numbers:
            raise wrong(file, f"images.{n}.id", f"camera {image.cam} has two images of one instant")
        within(root / "frames", image.file_name)
        numbers[image.first_id, image.cam] = int(stem)
    # an instant has the number of the first of its cameras
    of_instant = {first_id: numbers[first_id, cam] for first_id, cam in sorted(numbers, reverse=True)}
    if len(set(of_instant.values())) != len(of_instant):
        raise wrong(file, "images.file_name", "two instants have frames of one number")
    frames = {i.id: _Frame(i.cam, i.file_name, i.first_id, of_instant[i.first_id] * PERIOD_NS) for i in dataset.images}
    if len(frames) != len(dataset.images):
        raise wrong(file, "images.id", "two images have one id")
    step = math.gcd(*np.diff(sorted(of_instant.values())).tolist())
    notes = [f"frames are numbered in steps of {step}, taken as {step * 80} ms apart"] if step > 1 else []
    by_number = {(i.cam, numbers[i.first_id, i.cam]): frames[i.id] for i in dataset.images}
    return _Frames(frames, by_number, {key: number * PERIOD_NS for key, number in of_instant.items()}), notes


def _camera(root: Path, cam: int, dataset: Dataset) -> Camera:
    """As ``calib`` says, or, without that folder, the camera's first image in ``wibam_all.json``."""
    image = next(image for image in dataset.images if image.cam == cam)
    picture = root / "frames" / image.file_name
    if image.width is not None and image.height is not None:
        size = (image.width, image.height)
    else:
        size = image_size_px(picture) if picture.is_file() else SIZE_PX
    path = root / "calib" / f"calibration_{cam}.npz"
    said = (
        _read_calibration(path)
        if path.parent.is_dir()
        else {"camera_matrix": image.P, "dist_coefs": image.dist_coefs, "rvec": image.rvec, "tvec": image.tvec}
    )
    try:
        pose = SE3.from_rvec_tvec(said["rvec"], said["tvec"]).inverse()
        return Camera(np.reshape(said["camera_matrix"], (3, 3)), np.ravel(said["dist_coefs"]), pose, *size)
    except ValueError as error:
        raise wrong(path, "camera", str(error)) from error


def _read_calibration(path: Path) -> Mapping[str, np.ndarray]:
    names = ("camera_matrix", "dist_coefs", "rvec", "tvec")
    read_bytes(path, _MOST_CALIBRATION_BYTES)  # there, and not too large
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > _MOST_CALIBRATION_BYTES:
                raise wrong(path, "arrays", f"more than {_MOST_CALIBRATION_BYTES} bytes")
        with np.load(path, allow_pickle=False) as arrays:
            found = {name: np.asarray(arrays[name], dtype=np.float64) for name in names}
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile, NotImplementedError) as error:
        raise wrong(path, "arrays", f"{', '.join(names)} are needed: {error}") from error
    if not all(np.isfinite(array).all() for array in found.values()):
        raise wrong(path, "arrays", "numbers must be finite")
    return found


def _instants(
    file: Path, dataset: Dataset, frames: _Frames, rig: CameraRig
) -> tuple[list[AnnotatedInstant], list[str]]:
    known = classes_by_name(lambda names: names.nuscenes)
    names = {category.id: category.name for category in dataset.categories}
    boxes: dict[int, list[tuple[Annotation, RoadUserClass]]] = {image_id: [] for image_id in frames.by_id}
    left_out: Counter[str] = Counter()
    for n, annotation in enumerate(dataset.annotations):
        if annotation.image_id not in boxes:
            raise wrong(file, f"annotations.{n}.image_id", f"there is no image {annotation.image_id}")
        name = names.get(annotation.category_id)
        if name is None:
            raise wrong(file, f"annotations.{n}.category_id", f"there is no category {annotation.category_id}")
        if name in known:
            boxes[annotation.image_id].append((annotation, known[name]))
        else:
            left_out[name] += 1
    detections: dict[int, dict[str, Detections2D]] = {first_id: {} for first_id in frames.times_ns}
    views: dict[int, dict[int, dict[str, int]]] = {first_id: {} for first_id in frames.times_ns}
    for image_id, frame in sorted(frames.by_id.items()):
        found = boxes[image_id]
        detections[frame.first_id][str(frame.cam)] = Detections2D(
            str(frame.cam),
            frame.time_ns,
            from_corner_xywh([a.bbox for a, _ in found]),
            np.array([a.score for a, _ in found]),
            np.array([c.number for _, c in found], np.int64),
        )
        # of two boxes with one vehicle's id in one image, the surer one is its
        for i in sorted(range(len(found)), key=lambda i: found[i][0].score):
            obj_id = found[i][0].obj_id
            if obj_id is not None:
                views[frame.first_id].setdefault(obj_id, {})[str(frame.cam)] = i
    instants = [
        AnnotatedInstant(
            time_ns,
            detections[first_id],
            tuple(
                vehicle
                for obj_id, of_vehicle in sorted(views[first_id].items())
                if (vehicle := _vehicle(obj_id, of_vehicle, detections[first_id], rig)) is not None
            ),
        )
        for first_id, time_ns in sorted(frames.times_ns.items(), key=lambda item: item[1])
    ]
    return instants, [f"{n} boxes of class {name!r} were left out" for name, n in sorted(left_out.items())]


def _vehicle(
    obj_id: int, views: Mapping[str, int], detections: Mapping[str, Detections2D], rig: CameraRig
) -> MultiViewVehicle | None:
    """A vehicle of given boxes, where its rays meet the plane of its class's middle; None where none does."""
    votes = np.zeros(len(CLASSES))
    for camera_id, i in views.items():
        votes[detections[camera_id].classes[i]] += detections[camera_id].scores[i]
    vehicle_class = CLASSES[int(votes.argmax())]
    boxes = {camera_id: detections[camera_id].boxes[i] for camera_id, i in views.items()}
    points = np.array(
        [
            intersect_plane(rig[camera_id], (box[:2] + box[2:]) / 2, vehicle_class.traits.plane_height_m)[:2]
            for camera_id, box in boxes.items()
        ]
    )
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return None
    x, y = points.mean(axis=0).tolist()
    return MultiViewVehicle(obj_id, -1, vehicle_class, x, y, dict(views))


def _splits(folder: Path, frames: _Frames) -> dict[str, list[int]]:
    splits: dict[str, list[int]] = {}
    for subset in SUBSETS:
        path = folder / f"{subset}.txt"
        if not path.is_file():
            continue
        splits[subset] = []
        for number, line in enumerate(read_text(path).split(), 1):
            frame = frames.by_id.get(int(line)) if line.isascii() and line.isdecimal() and len(line) < 19 else None
            if frame is None:
                raise wrong(path, f"line {number}", f"{line[:40]!r} is the id of no image")
            splits[subset].append(frame.time_ns)
    return splits
