"""How well boxes that were predicted in one view fit the other views and their own past: measures that need no label.

They say whether the views agree and whether motion is smooth, not whether boxes are right: an error of the calibration
that all views share, and sizes that are small in every view alike, stay hidden.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.metrics import Consistency
from wibam_core.evaluation.matching import assign
from wibam_core.evaluation.summary import mean_sd
from wibam_core.geometry.box3d import X, Y
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import project_boxes
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import AnnotatedInstant, Vehicles3D

Array = NDArray[np.float64]

#: A predicted box is a view's vehicle if its projection overlaps that view's 2D box by more.
MIN_OWN_IOU = 0.3
#: Sightings this far apart, s, do not tell how smooth a motion is.
_MAX_GAP_S = 1.0


class Agreement(NamedTuple):
    """One predicted box of a vehicle that several cameras see.

    Attributes:
        time_ns: the instant. camera_id: the view that the box was predicted in. row: of that view's predictions.
        track_id: of the vehicle, −1 where it was not followed over time.
        exposed_s: when that view's frame was exposed.
        x_m, y_m: the box's centre.
        own_iou: of its projection with the 2D box of its own view. other_ious: with those of the other views.
    """

    time_ns: int
    camera_id: str
    row: int
    track_id: int
    exposed_s: float
    x_m: float
    y_m: float
    own_iou: float
    other_ious: tuple[float, ...]


def self_consistency(
    predictions: Iterable[Vehicles3D],
    annotations: Iterable[AnnotatedInstant],
    rig: Mapping[str, Camera],
    classes: Collection[RoadUserClass] = CLASSES,
) -> Consistency:
    """Image IoU of predictions with the 2D boxes of the views that they were not made in, and how smoothly they move.

    Args:
        predictions: one entry per camera and instant; ``time_ns`` is the instant.
        annotations: automatic multi-view vehicles of the same instants.
        rig: camera id -> camera.
        classes: what the network knows; the annotations' other vehicles are no concern of its.
    """
    found, asked = agreements(predictions, annotations, rig, classes)
    others = np.array([iou for one in found for iou in one.other_ious])
    return Consistency(
        other_views=mean_sd(others),
        own_view=mean_sd(np.array([one.own_iou for one in found])),
        roughness_m=mean_sd(roughness(found)),
        pairs=len(others),
        found=len(found) / asked if asked else None,
    )


def agreements(
    predictions: Iterable[Vehicles3D],
    annotations: Iterable[AnnotatedInstant],
    rig: Mapping[str, Camera],
    classes: Collection[RoadUserClass] = CLASSES,
) -> tuple[list[Agreement], int]:
    """All predicted boxes of multi-view vehicles, and in how many views those could have been found."""
    by_frame = {(found.time_ns, found.camera_id): found for found in predictions}
    result: list[Agreement] = []
    asked = 0
    for instant in annotations:
        vehicles = [one for one in instant.vehicles if len(one.views) >= 2 and one.vehicle_class in classes]
        for camera_id, detected in instant.detections.items():
            found = by_frame.get((instant.time_ns, camera_id))
            seen = [vehicle for vehicle in vehicles if camera_id in vehicle.views]
            if found is None or not seen:
                continue
            asked += len(seen)
            targets = np.array([detected.boxes[vehicle.views[camera_id]] for vehicle in seen])
            overlap = image_iou(targets, project_boxes(rig[camera_id], found.boxes))
            for row, column in zip(*assign(1.0 - overlap, 1.0 - MIN_OWN_IOU), strict=True):
                box = found.boxes[column]
                others = {view: index for view, index in seen[row].views.items() if view != camera_id}
                result.append(
                    Agreement(
                        instant.time_ns,
                        camera_id,
                        int(column),
                        seen[row].track_id,
                        detected.frame_time_ns * 1e-9,
                        float(box[X]),
                        float(box[Y]),
                        float(overlap[row, column]),
                        tuple(
                            _overlap(rig[view], box, instant.detections[view].boxes[index])
                            for view, index in others.items()
                        ),
                    )
                )
    return result, asked


def roughness(found: Iterable[Agreement]) -> Array:
    """(K,) distance in m of each box from the straight line between the same vehicle's boxes before and after it.

    All are of one camera, and at most `_MAX_GAP_S` apart. Vehicles that brake and turn deviate by some centimetres at
    a few instants a second; the rest is error that changes from frame to frame.
    """
    tracks: dict[tuple[str, int], list[Agreement]] = {}
    for one in found:
        if one.track_id >= 0:
            tracks.setdefault((one.camera_id, one.track_id), []).append(one)
    parts = [np.empty(0)]
    for sightings in tracks.values():
        states = np.array(sorted((one.exposed_s, one.x_m, one.y_m) for one in sightings))
        before, here, after = states[:-2], states[1:-1], states[2:]
        near = (here[:, 0] - before[:, 0] <= _MAX_GAP_S) & (after[:, 0] - here[:, 0] <= _MAX_GAP_S)
        before, here, after = before[near], here[near], after[near]
        share = (here[:, :1] - before[:, :1]) / (after[:, :1] - before[:, :1])
        between = before[:, 1:] + share * (after[:, 1:] - before[:, 1:])
        parts.append(np.linalg.norm(here[:, 1:] - between, axis=1))
    return np.concatenate(parts)


def _overlap(camera: Camera, box: Array, target: Array) -> float:
    """Image IoU of a box (7,) with a 2D box (4,); 0 where the box is not in front of the camera."""
    return float(image_iou(project_boxes(camera, box[None]), target[None])[0, 0])
