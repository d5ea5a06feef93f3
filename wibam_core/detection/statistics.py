"""What was detected, counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

from wibam_core.documents.statistics import DetectionStatistics
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import AnnotatedInstant


def detection_statistics(
    instants: Sequence[AnnotatedInstant], camera_ids: Sequence[str], looked_for: Collection[RoadUserClass] = ()
) -> DetectionStatistics:
    """Counts of frames and 2D boxes, in all, by camera and by class.

    Args:
        instants: with detections.
        camera_ids: whose.
        looked_for: what the detector knows, as far as that is known beside what was found.
    """
    boxes: Counter[str] = Counter()
    classes: Counter[str] = Counter()
    for instant in instants:
        for camera_id, seen in instant.detections.items():
            boxes[camera_id] += len(seen)
            classes.update(CLASSES[number].value for number in seen.classes)
    known = [kind for kind in CLASSES if kind in looked_for or classes[kind]]
    return DetectionStatistics(
        frames=sum(len(instant.detections) for instant in instants),
        boxes=boxes.total(),
        boxes_by_camera={camera_id: boxes[camera_id] for camera_id in camera_ids},
        boxes_by_class={kind.value: classes[kind] for kind in known},
        unknown_classes=[kind.value for kind in CLASSES if kind not in known],
    )
