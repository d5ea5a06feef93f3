"""Multi-view vehicles: rays of all cameras' boxes are clustered at each instant, and followed in the images over time.

What mostly meets in one cluster while it is followed is one vehicle (`grouping`), and so is what goes on where one was
hidden (`stitching`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wibam_core.association.box_rays import BoxRays, box_rays
from wibam_core.association.dpmeans import constrained_dp_means
from wibam_core.association.grouping import group
from wibam_core.association.rays import POINT_SD_M
from wibam_core.association.stitching import Sightings, stitch
from wibam_core.association.tracklets import tracklets
from wibam_core.config import AssociateConfig
from wibam_core.documents.statistics import AssociationStatistics
from wibam_core.errors import NoMultiViewVehicles, NoVehicles
from wibam_core.progress import Progress, part, silent
from wibam_core.road_users import CLASSES, VULNERABLE
from wibam_core.scene import AnnotatedInstant, CameraRig, FloatArray, IntArray, MultiViewVehicle

#: The rays of so many instants are clustered together.
_TOGETHER = 500


@dataclass(frozen=True, eq=False)
class _Clusters:
    """Clusters of one instant's rays: K clusters."""

    labels: IntArray  # (N,) cluster of each ray
    sightings: Sightings
    class_votes: FloatArray  # (K, classes) sum of scores


def associate(
    instants: Sequence[AnnotatedInstant],
    rig: CameraRig,
    config: AssociateConfig,
    progress: Progress = silent,
    poses: Mapping[str, FloatArray] | None = None,
) -> list[AnnotatedInstant]:
    """Find which boxes of different cameras show the same vehicle, and follow it over time.

    A box seen by one camera alone stays a vehicle with one view, so that its track does not break; boxes out of
    range belong to no vehicle.

    Args:
        instants: in order of time, with detections; their vehicles are ignored.
        rig: calibrated cameras; what other cameras saw is not looked at.
        config: radius, range, speed and for how long a vehicle may be hidden.
        progress: told now and then.
        poses: camera id -> (6, 6) covariance of its rotation and position, where that is known: rays of different
            cameras meet as far apart as these allow.

    Returns:
        The same instants with vehicles: ``obj_id`` counts within the instant, ``track_id`` is −1 for what is seen
        at one instant only, the class is the track's majority weighted by score.

    Raises:
        NoVehicles: no box in range at any instant.
        NoMultiViewVehicles: no vehicle seen by two cameras at once.
    """
    all_rays = box_rays(instants, rig, config.range_m, poses)
    if not len(all_rays):
        boxes = sum(len(d) for instant in instants for d in instant.detections.values())
        raise NoVehicles(
            f"{boxes} boxes in {len(instants)} instants, none of them on the ground within {config.range_m:g} m"
            if boxes
            else f"no vehicle was detected in any of {len(instants)} instants",
            boxes=boxes,
        )
    rays, labels, clustering = [], [], part(progress, 0.0, 0.8)
    for first in range(0, len(instants), _TOGETHER):
        clustering(first / len(instants), "clustering rays")
        some = range(first, min(first + _TOGETHER, len(instants)))
        own = all_rays.of(some)
        found = _clustered(own, config.cluster_radius_m)
        for number in some:
            rays.append(own.of(range(number, number + 1)))
            labels.append(found[own.rows_of(range(number, number + 1))])
    progress(0.8, "following over time")
    vehicles = _followed(instants, rays, labels, tuple(rig), config.max_gap_s)
    clusters = [_clusters(r, np.unique(v, return_inverse=True)[1]) for r, v in zip(rays, vehicles, strict=True)]
    tracks = stitch([c.sightings for c in clusters], [np.unique(v) for v in vehicles], config)
    classes = _track_classes(clusters, tracks)
    annotated = [
        replace(instant, vehicles=_vehicles(r, c, t, k, tuple(rig)))
        for instant, r, c, t, k in zip(instants, rays, clusters, tracks, classes, strict=True)
    ]
    if not any(len(vehicle.views) > 1 for instant in annotated for vehicle in instant.vehicles):
        raise NoMultiViewVehicles(
            f"none of {sum(len(a.vehicles) for a in annotated)} vehicles was seen by two cameras at once"
        )
    progress(1.0, "associated")
    return annotated


def association_statistics(instants: Sequence[AnnotatedInstant]) -> AssociationStatistics:
    """Counts for a person and the report."""
    vehicles = [vehicle for instant in instants for vehicle in instant.vehicles]
    views = Counter(len(vehicle.views) for vehicle in vehicles)
    boxes = sum(len(d) for instant in instants for d in instant.detections.values())
    associated = sum(n * count for n, count in views.items() if n > 1)
    return AssociationStatistics(
        instants=len(instants),
        boxes=boxes,
        vehicles=sum(count for n, count in views.items() if n > 1),
        by_views={str(n): views[n] for n in sorted(views) if n > 1},
        single_view=views.get(1, 0),
        unassociated_share=1.0 - associated / boxes if boxes else 0.0,
        tracks=len({vehicle.track_id for vehicle in vehicles if vehicle.track_id >= 0}),
        most_vehicles_at_once=max((len(instant.vehicles) for instant in instants), default=0),
    )


def _followed(
    instants: Sequence[AnnotatedInstant],
    rays: Sequence[BoxRays],
    labels: Sequence[IntArray],
    camera_ids: tuple[str, ...],
    max_gap_s: float,
) -> list[IntArray]:
    """For every instant the vehicle (N,) that each ray belongs to, over all instants, counted from 0.

    The labels (N,) of an instant's rays say which cluster each is in.
    """
    numbers = tracklets(instants, camera_ids, max_gap_s)
    of_rays = [
        np.array([found[camera_ids[c]][row] for c, row in zip(r.cameras, r.rows, strict=True)], dtype=np.int64)
        for r, found in zip(rays, numbers, strict=True)
    ]
    count = 1 + max((int(ids.max(initial=-1)) for found in numbers for ids in found.values()), default=-1)
    cameras = np.zeros(count, dtype=np.int64)
    for r, ids in zip(rays, of_rays, strict=True):
        cameras[ids] = r.cameras
    vehicle = group(of_rays, labels, cameras)
    in_range = np.unique(np.concatenate([vehicle[ids] for ids in of_rays]))  # others are of no vehicle
    return [np.searchsorted(in_range, vehicle[ids]) for ids in of_rays]


def _clustered(rays: BoxRays, radius_m: float) -> IntArray:
    """The cluster (N,) in its instant of each ray: those of vehicles, then those of people on foot or on two wheels."""
    labels = np.empty(len(rays), dtype=np.int64)
    count = 0
    for vulnerable in (False, True):
        own = np.flatnonzero(VULNERABLE[rays.classes] == vulnerable)
        spreads = rays.covariances[own] / POINT_SD_M**2
        labels[own] = count + constrained_dp_means(
            rays.points[own], rays.cameras[own], spreads, rays.instants[own], radius_m
        )
        count = int(labels[own].max(initial=count - 1)) + 1
    return labels


def _clusters(rays: BoxRays, labels: IntArray) -> _Clusters:
    """Where the clusters of rays with these labels (N,) are."""
    count = int(labels.max(initial=-1)) + 1
    information = np.linalg.inv(rays.covariances)
    total, pull = np.zeros((count, 2, 2)), np.zeros((count, 2))
    np.add.at(total, labels, information)
    np.add.at(pull, labels, np.einsum("nij,nj->ni", information, rays.points))
    covariance = np.linalg.inv(total)
    origin = int(rays.times_ns[0]) if len(labels) else 0
    members = np.bincount(labels, minlength=count)
    late = np.bincount(labels, (rays.times_ns - origin).astype(np.float64), minlength=count) / members
    votes = np.zeros((count, len(CLASSES)))
    np.add.at(votes, (labels, rays.classes), rays.scores)
    sightings = Sightings(
        times_ns=origin + np.rint(late).astype(np.int64),
        positions=np.einsum("kij,kj->ki", covariance, pull),
        sd_m=np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2)),
        classes=votes.argmax(axis=1),
    )
    return _Clusters(labels, sightings, votes)


def _track_classes(clusters: Sequence[_Clusters], tracks: Sequence[IntArray]) -> list[IntArray]:
    """Class index of every cluster: its track's majority, or its own where it has no track."""
    count = max((int(t.max(initial=-1)) for t in tracks), default=-1) + 1
    votes = np.zeros((count, len(CLASSES)))
    for cluster, track in zip(clusters, tracks, strict=True):
        linked = track >= 0
        np.add.at(votes, track[linked], cluster.class_votes[linked])
    majority = votes.argmax(axis=1) if count else np.empty(0, dtype=np.int64)
    classes = []
    for cluster, track in zip(clusters, tracks, strict=True):
        own = cluster.class_votes.argmax(axis=1)
        linked = track >= 0
        own[linked] = majority[track[linked]]
        classes.append(own)
    return classes


def _vehicles(
    rays: BoxRays, clusters: _Clusters, tracks: IntArray, classes: IntArray, camera_ids: tuple[str, ...]
) -> tuple[MultiViewVehicle, ...]:
    views: list[dict[str, int]] = [{} for _ in tracks]
    for label, camera, row in zip(clusters.labels, rays.cameras, rays.rows, strict=True):
        views[label][camera_ids[camera]] = int(row)
    positions = clusters.sightings.positions
    return tuple(
        MultiViewVehicle(
            obj_id=k,
            track_id=int(tracks[k]),
            vehicle_class=CLASSES[int(classes[k])],
            x_m=float(positions[k, 0]),
            y_m=float(positions[k, 1]),
            views=views[k],
        )
        for k in range(len(tracks))
    )
