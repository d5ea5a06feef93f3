"""What was detected, counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from wibam_core.documents.statistics import DetectionStatistics
from wibam_core.road_users import CLASSES
from wibam_core.scene import AnnotatedInstant


def detection_statistics(instants: Sequence[AnnotatedInstant], camera_ids: Sequence[str]) -> DetectionStatistics:
    """Counts of frames and 2D boxes, in all, by camera and by class."""
    boxes: Counter[str] = Counter()
    classes: Counter[str] = Counter()
    for instant in instants:
        for camera_id, seen in instant.detections.items():
            boxes[camera_id] += len(seen)
            classes.update(CLASSES[number].value for number in seen.classes)
    return DetectionStatistics(
        frames=sum(len(instant.detections) for instant in instants),
        boxes=boxes.total(),
        boxes_by_camera={camera_id: boxes[camera_id] for camera_id in camera_ids},
        boxes_by_class={kind.value: classes[kind.value] for kind in CLASSES},
    )
