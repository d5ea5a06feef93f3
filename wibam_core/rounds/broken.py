"""Vehicles that teach under one track and could judge under another, since they were lost between.

Where association loses a vehicle at the end of the training part and finds it again after it, it has two tracks. Only
one teaches, but the vehicle is the same. So no track judges that may be the rest of one that taught.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np

from wibam_core.config import AssociateConfig
from wibam_core.scene import AnnotatedInstant, FloatArray

#: Places of vehicles are so uncertain, where one camera alone sees them, m: a track that begins so far beside or behind
#: the end of another may still be the same vehicle's.
_UNCERTAIN_M = 4.0
#: Its velocity is that over so much of a track at its end, and at its beginning, s.
_VELOCITY_S = 1.0
#: Slower than this a vehicle stands, m/s: noise moves it by as much.
_STANDING_MPS = 1.0


def broken_tracks(
    instants: Sequence[AnnotatedInstant], teaching: Set[int], end_ns: int, config: AssociateConfig
) -> frozenset[int]:
    """Tracks that begin after the training part where the vehicle of a track that teaches may have got to.

    Args:
        instants: associated, in order of time.
        teaching: tracks that teach.
        end_ns: the last instant of the training part.
        config: for how long a vehicle may be hidden.
    """
    tracks = _ways(instants)
    ended = [tracks[track] for track in sorted(teaching) if track in tracks]
    begun = {track: way for track, way in tracks.items() if track not in teaching and way.times_s[0] > end_ns * 1e-9}
    return frozenset(track for track, way in begun.items() if any(_goes_on(one, way, config) for one in ended))


@dataclass(frozen=True, eq=False)
class _Way:
    """Where a track was: times (N,), s, and places (N, 2), m."""

    times_s: FloatArray
    places: FloatArray

    def velocity(self, *, at_end: bool) -> FloatArray:
        """(2,) over its first or its last second, m/s; 0 of a single sighting."""
        edge = self.times_s[-1] if at_end else self.times_s[0]
        own = np.flatnonzero(np.abs(self.times_s - edge) <= _VELOCITY_S)
        span_s = self.times_s[own[-1]] - self.times_s[own[0]]
        return (self.places[own[-1]] - self.places[own[0]]) / span_s if span_s > 0 else np.zeros(2)


def _ways(instants: Sequence[AnnotatedInstant]) -> dict[int, _Way]:
    seen: dict[int, list[tuple[float, float, float]]] = {}
    for instant in instants:
        for vehicle in instant.vehicles:
            if vehicle.track_id >= 0:
                seen.setdefault(vehicle.track_id, []).append((instant.time_ns * 1e-9, vehicle.x_m, vehicle.y_m))
    arrays = {track: np.array(rows) for track, rows in seen.items()}
    return {track: _Way(rows[:, 0], rows[:, 1:]) for track, rows in arrays.items()}


def _goes_on(ended: _Way, begun: _Way, config: AssociateConfig) -> bool:
    hidden_s = abs(float(begun.times_s[0] - ended.times_s[-1]))
    before, after = ended.velocity(at_end=True), begun.velocity(at_end=False)
    speed = max(float(np.linalg.norm(before)), float(np.linalg.norm(after)))
    stands = speed < _STANDING_MPS
    if hidden_s > (config.max_hidden_standing_s if stands else config.max_hidden_moving_s):
        return False
    way = begun.places[0] - ended.places[-1]
    ahead_m = float(way @ before) / max(float(np.linalg.norm(before)), _STANDING_MPS)
    reach_m = _UNCERTAIN_M + (0.0 if stands else speed * hidden_s)
    return float(np.linalg.norm(way)) <= reach_m and ahead_m >= -_UNCERTAIN_M
