"""Which sightings of which vehicles cameras are refined by: a few of every moving vehicle that several cameras see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from wibam_core.association.rays import rig_centre
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.lifting.fit import FitProblem
from wibam_core.lifting.lift import clusters_in_motion, fit_problem, moved
from wibam_core.lifting.observations import observe
from wibam_core.lifting.trajectory import Tracks
from wibam_core.refinement.mounts import mounts_of
from wibam_core.road_users import BODIES, LOG_SIZE_MEAN, LOG_SIZE_SD, VULNERABLE
from wibam_core.scene import AnnotatedInstant, CameraRig, FloatArray, IntArray

#: At most so many sightings of a vehicle are looked at, none nearer to the next than this along its way, m: the errors
#: of a detector, and of a body that a vehicle does not quite have, last for as long.
_SIGHTINGS, _APART_M = 12, 2.0
#: At most so many vehicles: those that are seen by several cameras most often.
_VEHICLES = 200


@dataclass(frozen=True, eq=False)
class Sightings:
    """N sightings of M vehicles, each by two cameras at least.

    Attributes:
        problem: their edges, with what is known of sizes and headings before; float64, counted from ``origin``.
        cameras: (N, V) number of the camera of each view slot in the rig.
        vehicles: (N,) which vehicle, from 0 on. classes: (N,) its class index.
        velocities: (N, 2) of the vehicles on the ground, m/s.
        origin: (2,) where the middle of the cameras is in the world, m.
    """

    problem: FitProblem
    cameras: IntArray
    vehicles: IntArray
    classes: IntArray
    velocities: FloatArray
    origin: FloatArray

    def __len__(self) -> int:
        return len(self.vehicles)

    @property
    def vehicle_count(self) -> int:
        return int(self.vehicles.max(initial=-1)) + 1

    def of_vehicles(self, chosen: NDArray[np.bool_]) -> Sightings:
        """Those of some of the M vehicles, which are numbered anew."""
        rows = np.flatnonzero(chosen[self.vehicles])
        number = np.cumsum(chosen) - 1
        return Sightings(
            self.problem[torch.as_tensor(rows)],
            self.cameras[rows],
            number[self.vehicles[rows]],
            self.classes[rows],
            self.velocities[rows],
            self.origin,
        )

    def through(self, rig: CameraRig) -> FitProblem:
        """The same edges, seen by other cameras."""
        cameras = _tensors(rig, self.origin)[torch.as_tensor(self.cameras)]
        return replace(self.problem, cameras=cameras)


def choose(instants: Sequence[AnnotatedInstant], rig: CameraRig) -> Sightings:
    """Sightings of moving vehicles, spread over their ways.

    Args:
        instants: associated and followed over time.
        rig: the cameras by which they were.
    """
    seen = observe(instants, rig, 1)
    seen = seen.where((seen.tracks >= 0) & ~VULNERABLE[seen.classes])
    origin = rig_centre(rig)
    seen = replace(seen, positions=seen.positions - origin)
    tracks = Tracks.group(seen.tracks, seen.times_ns)
    cameras = [moved(camera, -origin) for camera in rig.values()]
    motion, yaw, yaw_sd = clusters_in_motion(seen, cameras, tracks, 2)
    places = tracks.scatter(motion.position, seen.positions.copy())
    mounts = np.where(seen.seen, mounts_of(rig)[0][seen.cameras], -1)
    several = np.array([len(set(row) - {-1}) > 1 for row in mounts.tolist()], dtype=bool)
    usable = several & np.isfinite(yaw_sd)
    rows, vehicles = _spread(tracks, usable, places)
    problem = fit_problem(
        seen,
        _tensors(rig, origin),
        tracks,
        motion,
        LOG_SIZE_MEAN[seen.classes],
        LOG_SIZE_SD[seen.classes],
        yaw,
        2 * yaw_sd,
        BODIES,
        torch.float64,
    )
    velocities = tracks.scatter(motion.velocity, np.zeros((len(seen), 2)))
    return Sightings(
        problem[torch.as_tensor(rows)], seen.cameras[rows], vehicles, seen.classes[rows], velocities[rows], origin
    )


def _spread(tracks: Tracks, usable: NDArray[np.bool_], places: FloatArray) -> tuple[IntArray, IntArray]:
    """Rows of the sightings that are looked at, and the vehicle of each."""
    chosen: list[IntArray] = []
    for own, valid in zip(tracks.rows, tracks.valid, strict=True):
        rows = own[valid]
        rows = rows[usable[rows]]
        if len(rows):
            steps = np.linalg.norm(np.diff(places[rows], axis=0), axis=1)
            way_m = np.concatenate([[0.0], np.cumsum(steps)])
            apart_m = max(_APART_M, way_m[-1] / _SIGHTINGS)
            chosen.append(rows[np.unique(np.floor(way_m / apart_m), return_index=True)[1]])
    longest = sorted(range(len(chosen)), key=lambda k: (-len(chosen[k]), k))[:_VEHICLES]
    kept = [chosen[k] for k in sorted(longest)]
    none = np.empty(0, np.int64)
    return np.concatenate([*kept, none]), np.repeat(np.arange(len(kept)), [len(rows) for rows in kept])


def _tensors(rig: CameraRig, origin: FloatArray) -> CameraTensors:
    return CameraTensors.from_cameras([moved(camera, -origin) for camera in rig.values()], torch.float64)
