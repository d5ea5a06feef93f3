"""Fits to all views by track and instant, moved to when a frame was exposed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wibam_core.geometry.box3d import XY, YAW
from wibam_core.scene import FloatArray, Vehicles3D

#: A track's velocity is taken from instants at most this far apart.
_VELOCITY_SPAN_NS = 2_000_000_000


@dataclass(frozen=True, eq=False)
class FitOfTrack:
    """One fit: box (7,), index of the class, confidence in [0, 1], s.d. of the yaw in rad."""

    box: FloatArray
    vehicle_class: int
    confidence: float
    yaw_sd_rad: float


class FitsByTrack:
    """Fits by track and instant."""

    def __init__(self, lifts: Sequence[Vehicles3D]) -> None:
        self._tracks: dict[int, dict[int, FitOfTrack]] = {}
        self._tracks_at: dict[int, list[int]] = {}
        for vehicles in sorted(lifts, key=lambda one: one.time_ns):
            for row, track in enumerate(vehicles.ids.tolist()):
                kind, score, yaw_sd = vehicles.classes[row], vehicles.scores[row], vehicles.sd[row, YAW]
                fit = FitOfTrack(vehicles.boxes[row], int(kind), float(score), float(yaw_sd))
                self._tracks.setdefault(track, {})[vehicles.time_ns] = fit
                self._tracks_at.setdefault(vehicles.time_ns, []).append(track)

    def find(self, track: int, time_ns: int) -> FitOfTrack | None:
        """Of a track at an instant, where it has one."""
        return self._tracks.get(track, {}).get(time_ns)

    def of(self, track: int, time_ns: int) -> FitOfTrack:
        """Of a track that has one at the instant."""
        return self._tracks[track][time_ns]

    def tracks_at(self, time_ns: int) -> list[int]:
        """The tracks that have a fit at the instant."""
        return self._tracks_at.get(time_ns, [])

    def box_at(self, track: int, time_ns: int, exposed_ns: int) -> FloatArray:
        """(7,) the fit of the instant, moved to where the vehicle is when a frame is exposed."""
        box = self.of(track, time_ns).box.copy()
        box[XY] += self._velocity_mps(track, time_ns) * (exposed_ns - time_ns) * 1e-9
        return box

    def _velocity_mps(self, track: int, time_ns: int) -> FloatArray:
        """(2,) between the track's fits before and after the instant; 0 where it has no neighbour in time."""
        times = np.array(list(self._tracks[track]), dtype=np.int64)
        near = np.flatnonzero(np.abs(times - time_ns) <= _VELOCITY_SPAN_NS / 2)
        here = int(np.searchsorted(times, time_ns))
        first, last = max(near[0], here - 1), min(near[-1], here + 1)
        if first == last:
            return np.zeros(2)
        fits = self._tracks[track]
        moved = fits[int(times[last])].box[XY] - fits[int(times[first])].box[XY]
        return np.asarray(moved / ((times[last] - times[first]) * 1e-9))
