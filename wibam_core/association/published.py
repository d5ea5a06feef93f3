"""Association as the published method has it, beside ours.

At each instant by itself the rays of all cameras' boxes are met with the ground, and the ground points clustered by
DP-means (Kulis & Jordan, "Revisiting k-means: new algorithms via Bayesian nonparametrics", ICML 2012, algorithm 1) in
plain distances: without regard to which camera a point is from, how flat its ray is, and what was seen before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from wibam_core.association.box_rays import BoxRays, box_rays
from wibam_core.config import AssociateConfig
from wibam_core.documents.statistics import AssociationAgreement
from wibam_core.road_users import CLASSES
from wibam_core.scene import AnnotatedInstant, CameraRig, FloatArray, IntArray, MultiViewVehicle

_MAX_SWEEPS = 50


def dp_means(points: FloatArray, radius_m: float) -> IntArray:
    """Clusters (N,), from 0 on, of points (N, 2), m.

    One cluster at the mean of all is begun with. In turn, every point goes to the nearest mean, or opens a cluster
    where that is farther than ``radius_m``, and means are computed anew, until nothing changes.
    """
    means = points.mean(axis=0, keepdims=True) if len(points) else np.empty((0, 2))
    labels = np.zeros(len(points), dtype=np.int64)
    for _ in range(_MAX_SWEEPS):
        before = labels.copy()
        for k, point in enumerate(points):
            squared = np.square(means - point).sum(axis=1)
            labels[k] = int(squared.argmin())
            if squared[labels[k]] > radius_m**2:
                labels[k] = len(means)
                means = np.concatenate([means, point[None]])
        labels = np.asarray(np.unique(labels, return_inverse=True)[1], dtype=np.int64)
        counts = np.bincount(labels)
        means = np.stack([np.bincount(labels, own) / counts for own in points.T], axis=1)
        if (labels == before).all():
            break
    return labels


def clustered_as_published(
    instants: Sequence[AnnotatedInstant], rig: CameraRig, config: AssociateConfig
) -> list[AnnotatedInstant]:
    """The vehicles of each instant by clusters of its ground points, not followed over time: all track ids are −1.

    Where a cluster holds several boxes of one camera, the one nearest to its mean is the vehicle's, and each of the
    others a vehicle with one view: what is published does not say.

    Args:
        instants: in order of time, with detections; their vehicles are ignored.
        rig: calibrated cameras.
        config: radius and range.
    """
    rays = box_rays(instants, rig, config.range_m)
    return [
        replace(instant, vehicles=_vehicles(rays.of(range(number, number + 1)), config.cluster_radius_m, tuple(rig)))
        for number, instant in enumerate(instants)
    ]


def _vehicles(rays: BoxRays, radius_m: float, camera_ids: tuple[str, ...]) -> tuple[MultiViewVehicle, ...]:
    labels = dp_means(rays.points, radius_m)
    groups: list[list[int]] = []
    for label in range(int(labels.max(initial=-1)) + 1):
        rows = np.flatnonzero(labels == label)
        off = np.linalg.norm(rays.points[rows] - rays.points[rows].mean(axis=0), axis=1)
        nearest: dict[int, int] = {}
        for row in rows[np.argsort(off, kind="stable")].tolist():
            if nearest.setdefault(int(rays.cameras[row]), row) != row:
                groups.append([row])
        groups.append(list(nearest.values()))
    return tuple(_vehicle(number, rays, rows, camera_ids) for number, rows in enumerate(groups))


def _vehicle(number: int, rays: BoxRays, rows: list[int], camera_ids: tuple[str, ...]) -> MultiViewVehicle:
    votes = np.bincount(rays.classes[rows], rays.scores[rows], minlength=len(CLASSES))
    x_m, y_m = rays.points[rows].mean(axis=0).tolist()
    views = {camera_ids[rays.cameras[row]]: int(rays.rows[row]) for row in rows}
    return MultiViewVehicle(number, -1, CLASSES[int(votes.argmax())], x_m, y_m, views)


def agreement_of(tracked: Sequence[AnnotatedInstant], paper: Sequence[AnnotatedInstant]) -> AssociationAgreement:
    """How many pairs of boxes each of two associations of the same boxes takes for one vehicle."""
    both = ours = theirs = 0
    for one, other in zip(tracked, paper, strict=True):
        mine, published = _pairs(one), _pairs(other)
        ours, theirs, both = ours + len(mine), theirs + len(published), both + len(mine & published)
    return AssociationAgreement(tracked_pairs=ours, paper_pairs=theirs, both=both)


def _pairs(instant: AnnotatedInstant) -> set[frozenset[tuple[str, int]]]:
    return {frozenset(pair) for vehicle in instant.vehicles for pair in combinations(vehicle.views.items(), 2)}
