"""A small content of every part, exact enough to be compared after it went through another format."""

from __future__ import annotations

import numpy as np

from tests.builders import corner_rig, site_of
from wibam_core.exchange.base import Content
from wibam_core.geometry.projection import project_boxes
from wibam_core.road_users import CLASSES
from wibam_core.scene import (
    AnnotatedInstant,
    CameraRig,
    Detections2D,
    LabelledInstant,
    MultiViewVehicle,
    Track,
    Vehicles3D,
)

PERIOD_NS = 80_000_000


def boxes_at(step: int) -> np.ndarray:
    """Three vehicles (3, 7) that drive on: a car to the east, a van to the north-west, a truck that stands."""
    return np.array(
        [
            [-6.0 + 0.8 * step, -2.0, 0.75, 4.4, 1.8, 1.5, 0.0],
            [4.0 - 0.5 * step, 5.0 + 0.5 * step, 1.1, 5.3, 2.0, 2.2, 3 * np.pi / 4],
            [-5.0, 7.0, 1.6, 8.0, 2.5, 3.2, -2.0],
        ]
    )


def annotated(rig: CameraRig, step: int) -> AnnotatedInstant:
    """What the cameras see of `boxes_at`, the last camera a little late; the truck is associated with nothing."""
    time_ns = step * PERIOD_NS
    boxes = boxes_at(step)
    detections: dict[str, Detections2D] = {}
    views: list[dict[str, int]] = [{} for _ in boxes]
    for number, (camera_id, camera) in enumerate(rig.items()):
        projected = project_boxes(camera, boxes)
        seen = np.flatnonzero(np.isfinite(projected).all(axis=1))
        late_ns = 7_000_000 if number == len(rig) - 1 else 0
        scores = np.array([0.9, 0.75, 0.5])[seen]
        detections[camera_id] = Detections2D(camera_id, time_ns + late_ns, projected[seen], scores, seen)
        for i, vehicle in enumerate(seen.tolist()):
            views[vehicle][camera_id] = i
    vehicles = tuple(
        MultiViewVehicle(k, 10 + k, CLASSES[k], float(boxes[k, 0]), float(boxes[k, 1]), views[k]) for k in (0, 1)
    )
    return AnnotatedInstant(time_ns, detections, vehicles)


def content(steps: int = 5) -> Content:
    """Everything, for ``steps`` instants 80 ms apart seen by three cameras."""
    rig = corner_rig(3)
    times = np.arange(steps, dtype=np.int64) * PERIOD_NS
    boxes = np.stack([boxes_at(step) for step in range(steps)])
    sd = np.full((steps, 7), 0.1)
    velocities = np.array([[10.0, 0.0], [-6.25, 6.25], [0.0, 0.0]])
    return Content(
        site=site_of(rig),
        rig=rig,
        instants=[annotated(rig, step) for step in range(steps)],
        boxes_3d=[
            Vehicles3D(
                int(time), b, np.arange(3), np.array([10, 11, -1]), np.array([0.9, 0.8, 0.7]), np.full((3, 7), 0.1)
            )
            for time, b in zip(times, boxes, strict=True)
        ],
        tracks=[
            Track(10 + k, CLASSES[k], times, boxes[:, k], sd, np.tile(velocities[k], (steps, 1)), np.zeros(steps))
            for k in range(3)
        ],
        labels=[
            LabelledInstant(
                Vehicles3D.of(int(time), b, np.arange(3), np.array([10, 11, 12])),
                {camera_id: np.array([1.0, 0.75, 0.5]) for camera_id in rig},
            )
            for time, b in zip(times, boxes, strict=True)
        ],
    )


def assert_same_instants(read: list[AnnotatedInstant], written: list[AnnotatedInstant], *, atol: float = 1e-9) -> None:
    """Equal but for amodal boxes, which no other format holds."""
    assert [instant.time_ns for instant in read] == [instant.time_ns for instant in written]
    for a, b in zip(read, written, strict=True):
        assert a.vehicles == b.vehicles
        assert list(a.detections) == list(b.detections)
        for camera_id, seen in a.detections.items():
            expected = b.detections[camera_id]
            assert (seen.camera_id, seen.frame_time_ns) == (expected.camera_id, expected.frame_time_ns)
            np.testing.assert_allclose(seen.boxes, expected.boxes, rtol=0, atol=atol)
            np.testing.assert_allclose(seen.scores, expected.scores, rtol=0, atol=1e-6)
            np.testing.assert_array_equal(seen.classes, expected.classes)
