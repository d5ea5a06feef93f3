"""One box per vehicle and instant from the detections of all cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import LENGTH, XY, YAW
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import CLASSES
from wibam_core.scene import Vehicles3D

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Length of a usual car. The place of a longer vehicle is less certain along its length.
_REFERENCE_LENGTH_M = 4.5
#: (7,) in the order of boxes, m and rad: the least standard deviations of a fused box, since averaging views does not
#: remove the errors that they share (calibration, a bias of the network).
SD_FLOOR = np.array([0.15, 0.15, 0.08, 0.2, 0.08, 0.08, 0.05])
#: (7,) in the order of boxes, m and rad: standard deviations of a detection that states none.
SD_UNKNOWN = np.array([0.6, 0.6, 0.2, 0.5, 0.2, 0.2, 0.25])


@dataclass(frozen=True, eq=False)
class Fused:
    """Vehicles at one instant, seen by one or more cameras each.

    Attributes:
        boxes: (K, 7). sd: (K, 7), never NaN.
        votes: (K, C) sum of the scores for each class of `CLASSES`.
        headings: (K, 2) sum of the scores of the views that saw the vehicle head along the yaw, and against it.
        views: (K,) number of cameras.
    """

    boxes: Array
    sd: Array
    votes: Array
    headings: Array
    views: Indices

    def __len__(self) -> int:
        return len(self.boxes)


def fuse(detections: Sequence[Vehicles3D], radius_m: float) -> Fused:
    """Cluster detections on the ground, at most one per camera in each cluster, and average each cluster.

    Pairs are joined nearest first while every two of a cluster stay within reach (complete linkage). Numbers are
    weighted by score over variance: a near camera knows the place better than a far one.

    Args:
        detections: one entry per camera, all moved to the same instant.
        radius_m: of a cluster, see `ground_distance`.
    """
    boxes = np.concatenate([np.empty((0, 7)), *(d.boxes for d in detections)])
    sd = np.concatenate([np.empty((0, 7)), *(d.sd for d in detections)])
    sd = np.hypot(np.where(np.isfinite(sd), sd, SD_UNKNOWN), SD_FLOOR)
    scores = np.concatenate([np.empty(0), *(d.scores for d in detections)])
    classes = np.concatenate([np.empty(0, np.int64), *(d.classes for d in detections)])
    camera = np.repeat(np.arange(len(detections)), [len(d) for d in detections])
    clusters = _cluster(boxes, camera, radius_m)
    merged = [_merge(boxes[rows], sd[rows], scores[rows], classes[rows]) for rows in clusters]
    return Fused(
        np.array([m[0] for m in merged]).reshape(-1, 7),
        np.array([m[1] for m in merged]).reshape(-1, 7),
        np.array([m[2] for m in merged]).reshape(-1, len(CLASSES)),
        np.array([m[3] for m in merged]).reshape(-1, 2),
        np.array([len(rows) for rows in clusters], np.int64),
    )


def ground_distance(a: Array, b: Array) -> Array:
    """Distances (N, M) in m of centres of boxes a (N, 7) and b (M, 7), shortened along long vehicles.

    Along the heading of b it counts as much less as the longer of the two exceeds the reference length: the centre
    of a bus is less certain than that of a car.
    """
    offset = a[:, None, XY] - b[None, :, XY]
    c, s = np.cos(b[:, YAW]), np.sin(b[:, YAW])
    along = c * offset[..., 0] + s * offset[..., 1]
    across = -s * offset[..., 0] + c * offset[..., 1]
    length = np.maximum(a[:, None, LENGTH], b[None, :, LENGTH])
    return np.hypot(along / np.maximum(1.0, length / _REFERENCE_LENGTH_M), across)


def _cluster(boxes: Array, camera: Indices, radius_m: float) -> list[list[int]]:
    distance = ground_distance(boxes, boxes)
    distance = np.minimum(distance, distance.T)
    allowed = (camera[:, None] != camera) & (distance <= radius_m)
    i, j = np.nonzero(np.triu(allowed, 1))
    members: list[list[int]] = [[k] for k in range(len(boxes))]
    for pair in np.argsort(distance[i, j], kind="stable"):
        first, second = members[i[pair]], members[j[pair]]
        if first is second or not allowed[np.ix_(first, second)].all():
            continue
        first.extend(second)
        for k in second:
            members[k] = first
    return [sorted(rows) for k, rows in enumerate(members) if min(rows) == k]


def _merge(boxes: Array, sd: Array, scores: Array, classes: Indices) -> tuple[Array, Array, Array, Array]:
    weights = scores[:, None] / sd**2
    box = (weights * boxes).sum(axis=0) / weights.sum(axis=0)
    axis = 0.5 * np.arctan2(
        (weights[:, YAW] * np.sin(2 * boxes[:, YAW])).sum(), (weights[:, YAW] * np.cos(2 * boxes[:, YAW])).sum()
    )
    forward = np.cos(boxes[:, YAW] - axis) >= 0
    headings = np.array([scores[forward].sum(), scores[~forward].sum()])
    if headings[1] > headings[0]:
        axis, headings = axis + np.pi, headings[::-1]
    box[YAW] = normalise_angle(axis)
    spread = np.sqrt(np.sum(scores) / np.maximum(weights.sum(axis=0), 1e-12) / len(scores))
    votes = np.bincount(classes, weights=scores, minlength=len(CLASSES)).astype(np.float64)
    return box, np.maximum(spread, SD_FLOOR), votes, headings
