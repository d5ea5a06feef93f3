"""One box per vehicle and instant from the detections of all cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import LENGTH, XY, YAW
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import CLASSES, may_be_one
from wibam_core.scene import Vehicles3D

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Length of a usual car. The place of a longer vehicle is less certain along its length.
_REFERENCE_LENGTH_M = 4.5
#: (classes,) in the order of `CLASSES`: distances within which two may be one, as a share of those of vehicles.
REACH: Array = np.minimum([c.traits.place_scale for c in CLASSES], 1.0)
REACH.setflags(write=False)
#: (7,) in the order of boxes, m and rad: the least standard deviations of a fused box, since averaging views does not
#: remove the errors that they share (calibration, a bias of the network).
SD_FLOOR = np.array([0.15, 0.15, 0.08, 0.2, 0.08, 0.08, 0.05])
#: (7,) in the order of boxes, m and rad: standard deviations of a detection that states none.
SD_UNKNOWN = np.array([0.6, 0.6, 0.2, 0.5, 0.2, 0.2, 0.25])

#: Two are near each other within the radius; within so many times that, if they are by no more than so many of their
#: standard deviations apart: a far camera knows a place to a metre or two.
_UNCERTAIN_REACH, _NEAR_SDS = 1.5, 2.0


@dataclass(frozen=True, eq=False)
class Detected:
    """What all cameras detected at one instant, one after the other: N boxes.

    Attributes:
        boxes: (N, 7). sd: (N, 7), NaN where unknown. scores, classes: (N,), see `Vehicles3D`.
        cameras: (N,) number of the camera.
    """

    boxes: Array
    sd: Array
    scores: Array
    classes: Indices
    cameras: Indices

    @classmethod
    def of(cls, detections: Sequence[Vehicles3D]) -> Detected:
        """All of these, one entry per camera."""
        return cls(
            np.concatenate([np.empty((0, 7)), *(d.boxes for d in detections)]),
            np.concatenate([np.empty((0, 7)), *(d.sd for d in detections)]),
            np.concatenate([np.empty(0), *(d.scores for d in detections)]),
            np.concatenate([np.empty(0, np.int64), *(d.classes for d in detections)]),
            np.repeat(np.arange(len(detections)), [len(d) for d in detections]),
        )

    def where(self, rows: Indices | NDArray[np.bool_]) -> Detected:
        """The selected boxes."""
        return Detected(self.boxes[rows], self.sd[rows], self.scores[rows], self.classes[rows], self.cameras[rows])

    def __len__(self) -> int:
        return len(self.boxes)


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

    @property
    def classes(self) -> Indices:
        """(K,) what most votes are for, indices into `wibam_core.road_users.CLASSES`."""
        return self.votes.argmax(axis=1)


def fuse(detected: Detected, radius_m: float) -> Fused:
    """Cluster detections on the ground, at most one per camera in each cluster, and average each cluster.

    Somebody on foot or on two wheels is never one with a vehicle. Pairs are joined nearest first while every two of a
    cluster stay within reach (complete linkage), which is longer where they do not know their places well. Numbers are
    weighted by score over variance: a near camera knows the place better than a far one.

    Args:
        detected: by all cameras, all moved to the same instant.
        radius_m: of a cluster, see `ground_distance`.
    """
    if not len(detected):
        return Fused(
            np.empty((0, 7)), np.empty((0, 7)), np.empty((0, len(CLASSES))), np.empty((0, 2)), np.empty(0, np.int64)
        )
    clusters = _cluster(detected, radius_m)
    views = np.array([len(rows) for rows in clusters], np.int64)
    members = detected.where(np.array([row for rows in clusters for row in rows], np.int64))
    return _merged(members, views)


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


def _cluster(detected: Detected, radius_m: float) -> list[list[int]]:
    boxes, cameras, reach = detected.boxes, detected.cameras, REACH[detected.classes]
    distance = ground_distance(boxes, boxes)
    distance = np.minimum(distance, distance.T)
    within_m = radius_m * np.maximum(reach[:, None], reach)
    near = (distance <= within_m) | ((distance <= _UNCERTAIN_REACH * within_m) & (_apart_sd(detected) <= _NEAR_SDS))
    allowed = near & (cameras[:, None] != cameras) & may_be_one(detected.classes, detected.classes)
    i, j = np.nonzero(np.triu(allowed, 1))
    order = np.argsort(distance[i, j], kind="stable")
    members: list[list[int]] = [[k] for k in range(len(boxes))]
    may_join = allowed.tolist()
    for a, b in zip(i[order].tolist(), j[order].tolist(), strict=True):
        first, second = members[a], members[b]
        if first is second or not all(may_join[one][other] for one in first for other in second):
            continue
        first.extend(second)
        for k in second:
            members[k] = first
    return [sorted(rows) for k, rows in enumerate(members) if min(rows) == k]


def _apart_sd(detected: Detected) -> Array:
    """(N, N) how far centres are apart, in standard deviations of both."""
    places = detected.boxes[:, XY]
    variance = np.where(np.isfinite(detected.sd), detected.sd, SD_UNKNOWN)[:, XY] ** 2
    return np.sqrt(((places[:, None] - places) ** 2 / (variance[:, None] + variance)).sum(axis=-1))


def _merged(members: Detected, views: Indices) -> Fused:
    """The weighted mean of each of K clusters, the members of which follow each other: views (K,) of each."""
    starts, of_member = np.cumsum(views) - views, np.repeat(np.arange(len(views)), views)
    boxes, scores = members.boxes, members.scores
    sd = np.hypot(np.where(np.isfinite(members.sd), members.sd, SD_UNKNOWN), SD_FLOOR)
    weights = scores[:, None] / sd**2
    yaw, yaw_weights = boxes[:, YAW], weights[:, YAW]

    def total(values: Array) -> Array:
        return np.add.reduceat(values, starts, axis=0)

    weight = total(weights)
    axis = 0.5 * np.arctan2(total(yaw_weights * np.sin(2 * yaw)), total(yaw_weights * np.cos(2 * yaw)))
    forward = np.cos(yaw - axis[of_member]) >= 0
    headings = np.stack([total(np.where(forward, scores, 0.0)), total(np.where(forward, 0.0, scores))], axis=1)
    against = headings[:, 1] > headings[:, 0]
    mean = total(weights * boxes) / weight
    mean[:, YAW] = normalise_angle(np.where(against, axis + np.pi, axis))
    spread = np.sqrt(total(scores)[:, None] / np.maximum(weight, 1e-12) / views[:, None])
    cells = of_member * len(CLASSES) + members.classes
    votes = np.bincount(cells, weights=scores, minlength=len(views) * len(CLASSES)).astype(np.float64)
    return Fused(
        mean,
        np.maximum(spread, SD_FLOOR),
        votes.reshape(-1, len(CLASSES)),
        np.where(against[:, None], headings[:, ::-1], headings),
        views,
    )
