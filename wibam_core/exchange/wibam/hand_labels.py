"""Hand labels of the published WIBAM data set, ``hand_labels/{cam}/{frame}.json``.

Each file maps numbers to the objects that the camera sees in that frame: ``location`` x, y, z (m, world), ``size``
length, width, height (m), ``rot`` about the vertical, counter-clockwise from world X, and ``visibility``, a share per
camera. Two things differ between the programs that were published with the data: whether ``rot`` is in radians or
degrees, and whether ``location`` is the middle of the bottom or of the box. They are decided by which reading
reprojects best onto the 2D boxes of the images.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, RootModel, model_validator

from wibam_core.exchange.files import read_json, wrong
from wibam_core.geometry.box3d import HEIGHT, SIZE, YAW, X, Y, Z
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.geometry.projection import project_boxes
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, FloatArray, LabelledInstant, Vehicles3D

_MOST_BYTES = 1 << 22
#: A sighting counts in the decision if this share of the vehicle is seen: a 2D box is around what is seen.
_WELL_SEEN = 0.9
#: Labels of two cameras within this, m and rad as written, are one vehicle's.
_SAME = 1e-3
#: An image box that overlaps a reprojection by this is the vehicle's, and says its class.
_ITS_BOX_IOU = 0.3


class _Object(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    location: tuple[float, float, float]
    size: tuple[float, float, float]
    rot: float = Field(ge=-1000, le=1000)
    visibility: tuple[float, ...] | float

    @model_validator(mode="before")
    @classmethod
    def _of_single_letters(cls, value: Any) -> Any:
        """Some of the published programs write x, y, z and l, w, h instead."""
        if isinstance(value, dict) and {"x", "y", "z", "l", "w", "h"} <= value.keys():
            return {**value, "location": [value[k] for k in "xyz"], "size": [value[k] for k in "lwh"]}
        return value


class _Objects(RootModel[dict[str, _Object]]):
    pass


@dataclass(frozen=True)
class _Reading:
    """How ``rot`` and ``location`` are meant."""

    degrees: bool
    bottom: bool

    def boxes(self, raw: FloatArray) -> FloatArray:
        """Raw labels (N, 7) location, size, rot as boxes (N, 7)."""
        boxes = raw.copy()
        boxes[:, YAW] = normalise_angle(np.radians(raw[:, 6]) if self.degrees else raw[:, 6])
        boxes[:, Z] += raw[:, 5] / 2 if self.bottom else 0.0
        return boxes

    @property
    def words(self) -> str:
        return (
            f"rot in {'degrees' if self.degrees else 'radians'}, "
            f"location in the middle of the {'bottom' if self.bottom else 'box'}"
        )


#: The first is how the published program that draws labels reads them; it stands where nothing decides.
_READINGS = tuple(_Reading(degrees, bottom) for degrees in (False, True) for bottom in (True, False))


@dataclass(frozen=True, eq=False)
class _Raw:
    """Labels of one instant: (N, 7) location, size, rot as written; camera id -> (N,) visibility of labelled frames."""

    time_ns: int
    values: FloatArray
    visibility: Mapping[str, FloatArray]


def read(
    folder: Path, times_ns: Mapping[tuple[int, int], int], instants: Sequence[AnnotatedInstant], rig: CameraRig
) -> tuple[list[LabelledInstant] | None, list[str]]:
    """Read all hand labels.

    Args:
        folder: ``hand_labels``.
        times_ns: (camera's number, frame's number) -> its instant.
        instants: 2D boxes, by which the reading is decided, and of which vehicles have their class.
        rig: cameras by their numbers.

    Returns:
        The labels by time, None where there is no such folder; and sentences on what was decided and left out.

    Raises:
        InputError: naming the file and the field.
    """
    if not folder.is_dir():
        return None, []
    raw, notes = _read_files(folder, times_ns, rig)
    detections = {instant.time_ns: instant.detections for instant in instants}
    overlaps = {
        reading: _mean_overlap([(labels, reading.boxes(labels.values)) for labels in raw], detections, rig)
        for reading in _READINGS
    }
    chosen = max(_READINGS, key=lambda reading: overlaps[reading])
    if np.isfinite(overlaps[chosen]):
        other = max((r for r in _READINGS if r.bottom != chosen.bottom), key=lambda reading: overlaps[reading])
        notes.append(
            f"hand labels are read with {chosen.words}: so their reprojections overlap the 2D boxes best, by "
            f"{overlaps[chosen]:.3f} on average, against {overlaps[other]:.3f} with {other.words}"
        )
    else:
        notes.append(f"no 2D box decides how hand labels are meant; they are read with {chosen.words}")
    return [_labelled(labels, chosen, detections.get(labels.time_ns, {}), rig) for labels in raw], notes


def documents(
    labels: Sequence[LabelledInstant], cameras: Sequence[str], numbers: Mapping[int, int]
) -> dict[str, dict[str, Any]]:
    """Files below ``hand_labels``, by name: rot in radians, location in the middle of the bottom.

    Args:
        labels: those at other times than those of ``numbers`` are left out: no frame shows them.
        cameras: ids in the order of their numbers.
        numbers: instant (ns) -> number of its frames.
    """
    files: dict[str, dict[str, Any]] = {}
    for instant in labels:
        vehicles = instant.vehicles
        if vehicles.time_ns not in numbers:
            continue
        none = np.zeros(len(vehicles))
        shares = np.array([instant.visibility.get(camera_id, none) for camera_id in cameras])
        for cam in range(len(cameras)):
            files[f"{cam}/{numbers[vehicles.time_ns]}.json"] = {
                str(i): {
                    "location": [box[X], box[Y], box[Z] - box[HEIGHT] / 2],
                    "size": box[SIZE],
                    "rot": box[YAW],
                    "visibility": shares[:, i].tolist(),
                }
                for i, box in enumerate(vehicles.boxes.tolist())
                if shares[cam, i] > 0
            }
    return files


def _read_files(folder: Path, times_ns: Mapping[tuple[int, int], int], rig: CameraRig) -> tuple[list[_Raw], list[str]]:
    by_instant: dict[int, dict[str, list[tuple[FloatArray, float]]]] = {}
    unseen = 0
    for camera_id in rig:
        for path in sorted((folder / camera_id).glob("*.json")):
            if not (path.stem.isascii() and path.stem.isdecimal() and len(path.stem) <= 12):
                raise wrong(path, "name", "the number of a frame is needed")
            objects = read_json(path, _Objects, _MOST_BYTES).root
            time_ns = times_ns.get((int(camera_id), int(path.stem)))
            if time_ns is None:
                unseen += 1
                continue
            by_instant.setdefault(time_ns, {})[camera_id] = [
                _raw(path, name, given, int(camera_id)) for name, given in objects.items()
            ]
    notes = [f"hand labels of {unseen} frames that are no images of the data set were left out"] if unseen else []
    partly = sum(len(of_cameras) < len(rig) for of_cameras in by_instant.values())
    if partly:
        notes.append(f"{partly} of {len(by_instant)} labelled instants are labelled in some of the cameras only")
    return [_merged(time_ns, by_instant[time_ns]) for time_ns in sorted(by_instant)], notes


def _raw(path: Path, name: str, given: _Object, cam: int) -> tuple[FloatArray, float]:
    """(7,) as written, and the share that this camera sees."""
    field = f"{name[:40]}.visibility"
    shares = given.visibility if isinstance(given.visibility, tuple) else (given.visibility,) * (cam + 1)
    if cam >= len(shares) or not 0 <= shares[cam] <= 1:
        raise wrong(path, field, f"a share in [0, 1] is needed for camera {cam}")
    if min(given.size) <= 0:
        raise wrong(path, f"{name[:40]}.size", "length, width and height must be positive")
    return np.array([*given.location, *given.size, given.rot]), shares[cam]


def _merged(time_ns: int, of_cameras: Mapping[str, Sequence[tuple[FloatArray, float]]]) -> _Raw:
    """Equal labels in several cameras' files are one vehicle."""
    values: list[FloatArray] = []
    shares: list[dict[str, float]] = []
    for camera_id, objects in of_cameras.items():
        for value, share in objects:
            same = [k for k, other in enumerate(values) if np.abs(other - value).max() <= _SAME]
            if not same:
                values.append(value)
                shares.append({})
            shares[same[0] if same else -1][camera_id] = share
    visibility = {camera_id: np.array([s.get(camera_id, 0.0) for s in shares]) for camera_id in of_cameras}
    return _Raw(time_ns, np.array(values).reshape(-1, 7), visibility)


def _mean_overlap(
    labels: Sequence[tuple[_Raw, FloatArray]], detections: Mapping[int, Mapping[str, Detections2D]], rig: CameraRig
) -> float:
    """Mean IoU of well seen labels' reprojections with the image box that fits best; −inf where there is none."""
    overlaps = []
    for raw, boxes in labels:
        for camera_id, share in raw.visibility.items():
            seen = detections.get(raw.time_ns, {}).get(camera_id)
            if seen is not None and len(seen) and (share >= _WELL_SEEN).any():
                projected = project_boxes(rig[camera_id], boxes[share >= _WELL_SEEN])
                overlaps.append(image_iou(projected, seen.boxes).max(axis=1))
    return float(np.concatenate(overlaps).mean()) if overlaps else -np.inf


def _labelled(raw: _Raw, reading: _Reading, detections: Mapping[str, Detections2D], rig: CameraRig) -> LabelledInstant:
    """Labels with the class of the image box that fits best, in any camera; a car where none does."""
    boxes = reading.boxes(raw.values)
    best = np.full(len(boxes), _ITS_BOX_IOU)
    classes = np.full(len(boxes), RoadUserClass.CAR.number, np.int64)
    for camera_id, share in raw.visibility.items():
        seen = detections.get(camera_id)
        if seen is None or not len(seen) or not len(boxes):
            continue
        overlap = image_iou(project_boxes(rig[camera_id], boxes), seen.boxes) * (share > 0)[:, None]
        better = overlap.max(axis=1) > best
        best = np.where(better, overlap.max(axis=1), best)
        classes = np.where(better, seen.classes[overlap.argmax(axis=1)], classes)
    return LabelledInstant(Vehicles3D.of(raw.time_ns, boxes, classes), dict(raw.visibility))
