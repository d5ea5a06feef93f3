"""Distributions of the annotation set: what the report draws."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from wibam_core.documents.base import Histogram
from wibam_core.documents.split import SUBSETS, Split
from wibam_core.documents.statistics import DatasetStatistics, SubsetStatistics
from wibam_core.road_users import CLASSES
from wibam_core.scene import AnnotatedInstant, CameraRig, FloatArray, MultiViewVehicle

#: Height at which a vehicle is looked at, m.
_MIDDLE_M = 0.75


def dataset_statistics(instants: Sequence[AnnotatedInstant], rig: CameraRig, split: Split) -> DatasetStatistics:
    """Counts per subset, and distributions over the instants of all subsets.

    Vehicles seen by fewer than two cameras are not counted.
    """
    subset_of = split.subset_of()
    used = [instant for instant in instants if instant.time_ns in subset_of]
    vehicles = [(instant, vehicle) for instant in used for vehicle in multi_view(instant)]
    depth, elevation = _view_geometry((vehicle for _, vehicle in vehicles), rig)
    tracks = Counter(vehicle.track_id for _, vehicle in vehicles if vehicle.track_id >= 0)
    classes = Counter(vehicle.vehicle_class for _, vehicle in vehicles)
    cameras = Counter(camera_id for _, vehicle in vehicles for camera_id in vehicle.views)
    return DatasetStatistics(
        subsets={name: _subset(name, [i for i in used if subset_of[i.time_ns] == name], split) for name in SUBSETS},
        by_views=_counts(len(vehicle.views) for _, vehicle in vehicles),
        by_class={c.value: classes[c] for c in CLASSES if classes[c]},
        boxes_by_camera={camera_id: cameras[camera_id] for camera_id in rig},
        depth_m=_histogram(depth, 5.0),
        elevation_deg=_histogram(elevation, 2.5),
        vehicles_per_instant=_histogram(np.array([len(multi_view(i)) for i in used], dtype=np.float64), 1.0),
        sightings_per_track=_histogram(np.array(list(tracks.values()), dtype=np.float64), 10.0),
    )


def multi_view(instant: AnnotatedInstant) -> tuple[MultiViewVehicle, ...]:
    """The vehicles that at least two cameras see."""
    return tuple(vehicle for vehicle in instant.vehicles if len(vehicle.views) > 1)


def _subset(name: str, instants: Sequence[AnnotatedInstant], split: Split) -> SubsetStatistics:
    vehicles = [vehicle for instant in instants for vehicle in multi_view(instant)]
    times = [instant.time_ns for instant in instants]
    return SubsetStatistics(
        instants=len(instants),
        seconds=round((max(times) - min(times)) * 1e-9, 3) if times else 0.0,
        vehicles=len(vehicles),
        boxes=sum(len(vehicle.views) for vehicle in vehicles),
        tracks=len({vehicle.track_id for vehicle in vehicles if vehicle.track_id >= 0}),
        left_out_tracks=len(split.left_out_tracks[name]),
    )


def _view_geometry(vehicles: Iterable[MultiViewVehicle], rig: CameraRig) -> tuple[FloatArray, FloatArray]:
    """Depth (B,) in m and elevation (B,) in degrees of every view of every vehicle."""
    points: Mapping[str, list[list[float]]] = {camera_id: [] for camera_id in rig}
    for vehicle in vehicles:
        for camera_id in vehicle.views:
            points[camera_id].append([vehicle.x_m, vehicle.y_m, _MIDDLE_M])
    depths, elevations = [], []
    for camera_id, camera in rig.items():
        world = np.array(points[camera_id], dtype=np.float64).reshape(-1, 3)
        offset = camera.centre_m - world
        depths.append(camera.to_camera(world)[:, 2])
        elevations.append(np.degrees(np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))))
    return np.concatenate(depths), np.concatenate(elevations)


def _counts(values: Iterable[int]) -> dict[str, int]:
    return {str(value): count for value, count in sorted(Counter(values).items())}


def _histogram(values: FloatArray, width: float) -> Histogram:
    """Counts in bins of equal width whose edges are multiples of it."""
    if not len(values):
        return Histogram(edges=[0.0, width], counts=[0])
    first, last = np.floor(values.min() / width), np.floor(values.max() / width) + 1
    edges = width * np.arange(first, last + 1)
    counts, _ = np.histogram(values, edges)
    return Histogram(edges=edges.tolist(), counts=counts.tolist())
