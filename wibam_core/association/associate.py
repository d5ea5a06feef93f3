"""Multi-view vehicles: rays of all cameras' boxes are clustered at each instant, and followed in the images over time.

What mostly meets in one cluster while it is followed is one vehicle (`grouping`), and so is what goes on where one was
hidden (`stitching`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from wibam_core.association.dpmeans import constrained_dp_means
from wibam_core.association.grouping import group
from wibam_core.association.rays import POINT_SD_M, ground_covariances, ground_points, rig_centre, within_range
from wibam_core.association.stitching import Sightings, stitch
from wibam_core.association.tracklets import tracklets
from wibam_core.config import AssociateConfig
from wibam_core.documents.statistics import AssociationStatistics
from wibam_core.errors import NoMultiViewVehicles, NoVehicles
from wibam_core.progress import Progress, part, silent
from wibam_core.road_users import CLASSES
from wibam_core.scene import AnnotatedInstant, CameraRig, FloatArray, IntArray, MultiViewVehicle


@dataclass(frozen=True, eq=False)
class _Rays:
    """Ground points of all boxes of one instant: N boxes that lie in range."""

    points: FloatArray  # (N, 2)
    covariances: FloatArray  # (N, 2, 2)
    cameras: IntArray  # (N,) number of the camera in the rig
    rows: IntArray  # (N,) index into that camera's detections
    times_ns: IntArray  # (N,) exposure
    scores: FloatArray  # (N,)
    classes: IntArray  # (N,)


@dataclass(frozen=True, eq=False)
class _Clusters:
    """Clusters of one instant's rays: K clusters."""

    labels: IntArray  # (N,) cluster of each ray
    sightings: Sightings
    class_votes: FloatArray  # (K, classes) sum of scores


def associate(
    instants: Sequence[AnnotatedInstant], rig: CameraRig, config: AssociateConfig, progress: Progress = silent
) -> list[AnnotatedInstant]:
    """Find which boxes of different cameras show the same vehicle, and follow it over time.

    A box seen by one camera alone stays a vehicle with one view, so that its track does not break; boxes out of
    range belong to no vehicle.

    Args:
        instants: in order of time, with detections; their vehicles are ignored.
        rig: calibrated cameras; what other cameras saw is not looked at.
        config: radius, range, speed and for how long a vehicle may be hidden.
        progress: told now and then.

    Returns:
        The same instants with vehicles: ``obj_id`` counts within the instant, ``track_id`` is −1 for what is seen
        at one instant only, the class is the track's majority weighted by score.

    Raises:
        NoVehicles: no box in range at any instant.
        NoMultiViewVehicles: no vehicle seen by two cameras at once.
    """
    rays = [_instant_rays(instant, rig, config.range_m) for instant in instants]
    if not any(len(r.rows) for r in rays):
        boxes = sum(len(d) for instant in instants for d in instant.detections.values())
        raise NoVehicles(
            f"{boxes} boxes in {len(instants)} instants, none of them on the ground within {config.range_m:g} m"
            if boxes
            else f"no vehicle was detected in any of {len(instants)} instants",
            boxes=boxes,
        )
    clusters = []
    clustering = part(progress, 0.0, 0.8)
    for index, instant_rays in enumerate(rays):
        if index % 50 == 0:
            clustering(index / len(rays), "clustering rays")
        clusters.append(_cluster(instant_rays, config.cluster_radius_m))
    progress(0.8, "following over time")
    vehicles = _followed(instants, rays, clusters, tuple(rig), config.max_gap_s)
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


def _instant_rays(instant: AnnotatedInstant, rig: CameraRig, range_m: float) -> _Rays:
    centre = rig_centre(rig)
    parts: list[tuple[FloatArray, FloatArray, IntArray, IntArray, IntArray, FloatArray, IntArray]] = []
    for number, (camera_id, camera) in enumerate(rig.items()):
        seen = instant.detections.get(camera_id)
        if seen is None or len(seen) == 0:
            continue
        points = ground_points(camera, seen)
        rows = np.flatnonzero(within_range(points, centre, range_m))
        parts.append(
            (
                points[rows],
                ground_covariances(camera, seen.where(rows), points[rows]),
                np.full(len(rows), number),
                rows,
                np.full(len(rows), seen.frame_time_ns),
                seen.scores[rows],
                seen.classes[rows],
            )
        )
    if not parts:
        none, nothing = np.empty(0, dtype=np.int64), np.empty(0)
        return _Rays(np.empty((0, 2)), np.empty((0, 2, 2)), none, none, none, nothing, none)
    return _Rays(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _followed(
    instants: Sequence[AnnotatedInstant],
    rays: Sequence[_Rays],
    clusters: Sequence[_Clusters],
    camera_ids: tuple[str, ...],
    max_gap_s: float,
) -> list[IntArray]:
    """For every instant the vehicle (N,) that each ray belongs to, over all instants, counted from 0."""
    numbers = tracklets(instants, camera_ids, max_gap_s)
    of_rays = [
        np.array([found[camera_ids[c]][row] for c, row in zip(r.cameras, r.rows, strict=True)], dtype=np.int64)
        for r, found in zip(rays, numbers, strict=True)
    ]
    count = 1 + max((int(ids.max(initial=-1)) for found in numbers for ids in found.values()), default=-1)
    cameras = np.zeros(count, dtype=np.int64)
    for r, ids in zip(rays, of_rays, strict=True):
        cameras[ids] = r.cameras
    vehicle = group(of_rays, [c.labels for c in clusters], cameras)
    in_range = np.unique(np.concatenate([vehicle[ids] for ids in of_rays]))  # others are of no vehicle
    return [np.searchsorted(in_range, vehicle[ids]) for ids in of_rays]


def _cluster(rays: _Rays, radius_m: float) -> _Clusters:
    return _clusters(rays, constrained_dp_means(rays.points, rays.cameras, rays.covariances / POINT_SD_M**2, radius_m))


def _clusters(rays: _Rays, labels: IntArray) -> _Clusters:
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
    rays: _Rays, clusters: _Clusters, tracks: IntArray, classes: IntArray, camera_ids: tuple[str, ...]
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
