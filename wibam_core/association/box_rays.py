"""All 2D boxes of a recording as rays that meet the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from wibam_core.association.rays import (
    LARGEST_SD_M,
    PLANE_HEIGHTS_M,
    ground_covariances,
    ground_points,
    rig_centre,
    within_range,
)
from wibam_core.calibration.covariance import CameraCovariance
from wibam_core.geometry.camera import Camera
from wibam_core.scene import AnnotatedInstant, CameraRig, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class BoxRays:
    """Ground points of all boxes that lie in range: N boxes, in the order of instants and then of cameras."""

    instants: IntArray  # (N,) number of the instant, ascending
    points: FloatArray  # (N, 2)
    covariances: FloatArray  # (N, 2, 2)
    cameras: IntArray  # (N,) number of the camera in the rig
    rows: IntArray  # (N,) index into that camera's detections
    times_ns: IntArray  # (N,) exposure
    scores: FloatArray  # (N,)
    classes: IntArray  # (N,)

    def __len__(self) -> int:
        return len(self.instants)

    def rows_of(self, numbers: range) -> slice:
        """Where the rays of consecutive instants are."""
        return slice(*np.searchsorted(self.instants, [numbers.start, numbers.stop]).tolist())

    def of(self, numbers: range) -> BoxRays:
        """The rays of consecutive instants."""
        rows = self.rows_of(numbers)
        return BoxRays(*(getattr(self, field.name)[rows] for field in fields(self)))


def box_rays(
    instants: Sequence[AnnotatedInstant],
    rig: CameraRig,
    range_m: float,
    poses: Mapping[str, FloatArray] | None = None,
) -> BoxRays:
    """The rays of all boxes whose ground points lie within ``range_m`` of the middle of the cameras.

    Args:
        instants: in order of time, with detections.
        rig: calibrated cameras; what other cameras saw is not looked at.
        range_m: from the middle of the cameras.
        poses: camera id -> (6, 6) covariance of its rotation and position; what is missing is taken to be exact.
    """
    centre = rig_centre(rig)
    none = np.empty(0, np.int64)
    parts = [BoxRays(none, np.empty((0, 2)), np.empty((0, 2, 2)), none, none, none, np.empty(0), none)]
    for number, (camera_id, camera) in enumerate(rig.items()):
        seen = [(k, i.detections[camera_id]) for k, i in enumerate(instants) if camera_id in i.detections]
        if not seen:
            continue
        counts = np.array([len(d) for _, d in seen])
        boxes = np.concatenate([d.whole_boxes for _, d in seen])
        classes = np.concatenate([d.classes for _, d in seen])
        points = ground_points(camera, boxes, classes)
        near = np.flatnonzero(within_range(points, centre, range_m))
        covariances = ground_covariances(camera, boxes[near], classes[near], points[near])
        if poses is not None and camera_id in poses:
            covariances = covariances + _by_pose(camera, points[near], classes[near], poses[camera_id])
        rows = np.arange(len(boxes)) - np.repeat(np.cumsum(counts) - counts, counts)
        parts.append(
            BoxRays(
                np.repeat([k for k, _ in seen], counts)[near],
                points[near],
                covariances,
                np.full(len(near), number),
                rows[near],
                np.repeat([d.frame_time_ns for _, d in seen], counts)[near],
                np.concatenate([d.scores for _, d in seen])[near],
                classes[near],
            )
        )
    columns = [np.concatenate([getattr(p, field.name) for p in parts]) for field in fields(BoxRays)]
    order = np.argsort(columns[0], kind="stable")
    return BoxRays(*(column[order] for column in columns))


def _by_pose(camera: Camera, points: FloatArray, classes: IntArray, pose: FloatArray) -> FloatArray:
    """(N, 2, 2) covariances, m², of ground points (N, 2) by an error of the camera's pose (6, 6), within limits."""
    if not len(points):
        return np.empty((0, 2, 2))
    found = CameraCovariance(pose, camera).ground_covariances(np.column_stack([points, PLANE_HEIGHTS_M[classes]]))
    size = np.trace(found, axis1=1, axis2=2)
    shrunk = np.minimum(1.0, LARGEST_SD_M**2 / np.maximum(size, 1e-12))
    return np.where(np.isfinite(size)[:, None, None], found * shrunk[:, None, None], 0.0)
