"""How well a box that was predicted in one view fits the other views: a measure that needs no label.

It says whether the views agree, not whether they are right: an error of the calibration that all views share, and
sizes that are small in every view alike, stay hidden.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wibam_core.evaluation.matching import assign
from wibam_core.evaluation.summary import mean_sd
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.iou import image_iou
from wibam_core.geometry.projection import project_boxes
from wibam_core.scene import AnnotatedInstant, Vehicles3D

Array = NDArray[np.float64]

#: A predicted box is a view's vehicle if its projection overlaps that view's 2D box by more.
MIN_OWN_IOU = 0.3


def self_consistency(
    predictions: Iterable[Vehicles3D], annotations: Iterable[AnnotatedInstant], rig: Mapping[str, Camera]
) -> dict[str, Any]:
    """Image IoU of predictions against the associated 2D boxes of the views that they were not made in.

    Args:
        predictions: one entry per camera and instant; ``time_ns`` is the instant.
        annotations: automatic multi-view vehicles of the same instants.
        rig: camera id -> camera.

    Returns:
        ``other_views`` and ``own_view``: ``{"mean", "sd"}`` of the IoU; ``pairs``: vehicle and other view;
        ``found``: share of the sightings of multi-view vehicles that have a prediction.
    """
    by_frame = {(found.time_ns, found.camera_id): found for found in predictions}
    own: list[float] = []
    others: list[float] = []
    asked = 0
    for instant in annotations:
        vehicles = [vehicle for vehicle in instant.vehicles if len(vehicle.views) >= 2]
        for camera_id in instant.detections:
            found = by_frame.get((instant.time_ns, camera_id))
            seen = [vehicle for vehicle in vehicles if camera_id in vehicle.views]
            if found is None or not seen:
                continue
            asked += len(seen)
            targets = np.array([instant.detections[camera_id].boxes[vehicle.views[camera_id]] for vehicle in seen])
            overlap = np.nan_to_num(image_iou(targets, project_boxes(rig[camera_id], found.boxes)))
            for row, column in zip(*assign(1.0 - overlap, 1.0 - MIN_OWN_IOU), strict=True):
                own.append(float(overlap[row, column]))
                for other_id, index in seen[row].views.items():
                    if other_id == camera_id:
                        continue
                    reprojected = project_boxes(rig[other_id], found.boxes[column][None])
                    target = instant.detections[other_id].boxes[index][None]
                    others.append(float(np.nan_to_num(image_iou(reprojected, target))[0, 0]))
    return {
        "other_views": mean_sd(np.array(others)),
        "own_view": mean_sd(np.array(own)),
        "pairs": len(others),
        "found": len(own) / asked if asked else None,
    }
