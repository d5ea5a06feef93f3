"""COCO object detection: one JSON file of images, categories and boxes (https://cocodataset.org/#format-data).

A box is ``[x, y, width, height]`` in px from the top left corner of the image, so that the centre of the first pixel
is (0.5, 0.5). Categories have COCO's own ids where COCO has the class, others follow after its last. Cameras, times
and identities are fields that COCO does not know and its readers pass over: of an image ``camera_id``,
``frame_time_ns``, ``time_ns`` (of the instant); of an annotation ``score``, ``obj_id``, ``track_id``, ``vehicle_class``
and ``ground_m`` (x, y in the world), of the vehicle associated with the box.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from wibam_core.exchange.base import Content, Part, parse_image_name, require_parts
from wibam_core.exchange.boxes import corner_xywh, from_corner_xywh
from wibam_core.exchange.files import read_json, wrong
from wibam_core.exchange.names import classes_by_name
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import AnnotatedInstant, Detections2D, MultiViewVehicle
from wibam_core.site import CameraId

_FILE = "instances.json"
#: COCO's category ids of road users.
_COCO_IDS = MappingProxyType({"person": 1, "bicycle": 2, "car": 3, "motorcycle": 4, "bus": 6, "train": 7, "truck": 8})
#: COCO's category ids end at 90; classes that it lacks follow.
_OWN_IDS_FROM = 91


class _Category(BaseModel):
    id: int
    name: str = Field(max_length=200)


class _Image(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    id: int
    file_name: str = Field(default="", max_length=1000)
    camera_id: CameraId | None = None
    frame_time_ns: int | None = Field(default=None, ge=-(2**62), le=2**62)
    time_ns: int | None = Field(default=None, ge=-(2**62), le=2**62)


class _Annotation(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    image_id: int
    category_id: int
    bbox: tuple[float, float, float, float]
    score: float = Field(default=1.0, ge=0, le=1)
    obj_id: int | None = None
    track_id: int = -1
    vehicle_class: RoadUserClass | None = None
    ground_m: tuple[float, float] | None = None


class _Dataset(BaseModel):
    images: tuple[_Image, ...]
    categories: tuple[_Category, ...]
    annotations: tuple[_Annotation, ...]


class Coco:
    """See this module."""

    name = "coco"
    title = "COCO object detection"
    needs = frozenset({Part.BOXES_2D})
    writes = frozenset({Part.BOXES_2D})
    reads = frozenset({Part.BOXES_2D})
    loses = (
        "3D boxes, tracks, labels and the calibration; of 2D boxes, the amodal ones and their standard deviations. "
        "Cameras, times and identities are fields that other programs pass over."
    )

    def write(self, content: Content, folder: Path) -> Sequence[Path]:
        """Write ``instances.json``."""
        require_parts(self, content)
        images: list[dict[str, Any]] = []
        annotations: list[dict[str, Any]] = []
        categories = _categories()
        for instant in content.instants or ():
            owners = {(camera, i): vehicle for vehicle in instant.vehicles for camera, i in vehicle.views.items()}
            for camera_id, seen in instant.detections.items():
                width_px, height_px = content.size_px(camera_id)
                images.append(
                    {
                        "id": len(images) + 1,
                        "file_name": content.image_name(camera_id, seen.frame_time_ns),
                        "width": width_px,
                        "height": height_px,
                        "camera_id": camera_id,
                        "frame_time_ns": seen.frame_time_ns,
                        "time_ns": instant.time_ns,
                    }
                )
                for i, bbox in enumerate(corner_xywh(seen.boxes).tolist()):
                    annotations.append(
                        {
                            "id": len(annotations) + 1,
                            "image_id": len(images),
                            "category_id": categories[CLASSES[seen.classes[i]]][0],
                            "bbox": bbox,
                            "area": bbox[2] * bbox[3],
                            "iscrowd": 0,
                            "score": float(seen.scores[i]),
                            **_identity(owners.get((camera_id, i))),
                        }
                    )
        document = {
            "info": {"description": content.site.name if content.site else "", "version": "1.0"},
            "images": images,
            "categories": [{"id": i, "name": name} for i, name in categories.values()],
            "annotations": annotations,
        }
        path = folder / _FILE
        path.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")
        return [path]

    def read(self, path: Path) -> Content:
        """Read a JSON file, or the ``instances.json`` of a folder.

        Categories that are no road users of ours are left out, and noted.
        """
        path = path / _FILE if path.is_dir() else path
        dataset = read_json(path, _Dataset)
        classes = {category.id: _class_of(category.name) for category in dataset.categories}
        names = {category.id: category.name for category in dataset.categories}
        images = {image.id: _place(path, n, image) for n, image in enumerate(dataset.images)}
        boxes: dict[int, list[_Annotation]] = {image_id: [] for image_id in images}
        left_out: Counter[str] = Counter()
        for n, annotation in enumerate(dataset.annotations):
            if annotation.image_id not in boxes:
                raise wrong(path, f"annotations.{n}.image_id", f"there is no image {annotation.image_id}")
            if annotation.category_id not in classes:
                raise wrong(path, f"annotations.{n}.category_id", f"there is no category {annotation.category_id}")
            if annotation.bbox[2] < 0 or annotation.bbox[3] < 0:
                raise wrong(path, f"annotations.{n}.bbox", "width and height must not be negative")
            if classes[annotation.category_id] is None:
                left_out[names[annotation.category_id]] += 1
            else:
                boxes[annotation.image_id].append(annotation)
        by_instant: dict[int, list[tuple[str, int, list[_Annotation]]]] = {}
        for image_id, (camera_id, frame_time_ns, time_ns) in images.items():
            by_instant.setdefault(time_ns, []).append((camera_id, frame_time_ns, boxes[image_id]))
        return Content(
            instants=[_instant(path, time_ns, by_instant[time_ns], classes) for time_ns in sorted(by_instant)],
            images={images[image.id][:2]: image.file_name for image in dataset.images if image.file_name},
            notes=tuple(f"{n} boxes of category {name!r} were left out" for name, n in sorted(left_out.items())),
        )


def _categories() -> dict[RoadUserClass, tuple[int, str]]:
    """Id and name by class: COCO's where COCO tells it apart, else an id of ours and our name."""
    own: Iterator[int] = iter(range(_OWN_IDS_FROM, _OWN_IDS_FROM + len(CLASSES)))
    named = {c: c.traits.elsewhere.coco.read for c in CLASSES}
    return {c: (_COCO_IDS[read[0]], read[0]) if read else (next(own), c.value) for c, read in named.items()}


def _class_of(name: str) -> RoadUserClass | None:
    """The class of a category's name, which is COCO's or ours; None of what is no road user of ours."""
    ours = {c.value: c for c in CLASSES}
    return classes_by_name(lambda names: names.coco).get(name, ours.get(name))


def _identity(vehicle: MultiViewVehicle | None) -> dict[str, Any]:
    if vehicle is None:
        return {}
    return {
        "obj_id": vehicle.obj_id,
        "track_id": vehicle.track_id,
        "vehicle_class": vehicle.vehicle_class.value,
        "ground_m": [vehicle.x_m, vehicle.y_m],
    }


def _place(path: Path, n: int, image: _Image) -> tuple[str, int, int]:
    """Camera id, frame time and instant (ns) of an image."""
    named = parse_image_name(image.file_name)
    camera_id = image.camera_id or (named and named[0])
    frame_time_ns = image.frame_time_ns if image.frame_time_ns is not None else (named and named[1])
    if camera_id is None or frame_time_ns is None:
        raise wrong(
            path,
            f"images.{n}",
            "neither camera_id and frame_time_ns nor the file name say whose image it is, and when it was exposed",
            "COCO has no cameras or times: add these two fields, or name images <camera id>/<time in ns>.jpg.",
        )
    return camera_id, frame_time_ns, frame_time_ns if image.time_ns is None else image.time_ns


def _instant(
    path: Path,
    time_ns: int,
    frames: Sequence[tuple[str, int, Sequence[_Annotation]]],
    classes: Mapping[int, RoadUserClass | None],
) -> AnnotatedInstant:
    detections: dict[str, Detections2D] = {}
    views: dict[int, dict[str, int]] = {}
    first: dict[int, _Annotation] = {}
    for camera_id, frame_time_ns, boxes in frames:
        if camera_id in detections:
            raise wrong(path, "images", f"camera {camera_id} has two images of the instant {time_ns} ns")
        numbers = [found.number for a in boxes if (found := classes[a.category_id]) is not None]
        detections[camera_id] = Detections2D(
            camera_id,
            frame_time_ns,
            from_corner_xywh(np.array([a.bbox for a in boxes])),
            np.array([a.score for a in boxes]),
            np.array(numbers, np.int64),
        )
        for i, annotation in enumerate(boxes):
            if annotation.obj_id is None or annotation.ground_m is None or annotation.vehicle_class is None:
                continue
            views.setdefault(annotation.obj_id, {})[camera_id] = i
            first.setdefault(annotation.obj_id, annotation)
    vehicles = []
    for obj_id, annotation in sorted(first.items()):
        assert annotation.vehicle_class is not None and annotation.ground_m is not None
        vehicles.append(
            MultiViewVehicle(obj_id, annotation.track_id, annotation.vehicle_class, *annotation.ground_m, views[obj_id])
        )
    return AnnotatedInstant(time_ns, detections, tuple(vehicles))
