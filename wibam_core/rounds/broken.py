"""Vehicles that teach under one track and could judge under another, since they were lost between.

Where association loses a vehicle at the end of the training part and finds it again after it, it has two tracks. Only
one teaches, but the vehicle is the same. So no track judges that may be the rest of one that taught.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
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
    ended = sorted((_end(way) for track, way in tracks.items() if track in teaching), key=lambda end: end.time_s)
    ended_s = [end.time_s for end in ended]
    # a second more, so that rounding decides nothing here
    longest_s = max(config.max_hidden_moving_s, config.max_hidden_standing_s) + 1.0
    broken = []
    for track, way in tracks.items():
        begun = _beginning(way)
        if track in teaching or begun.time_s <= end_ns * 1e-9:
            continue
        near = slice(bisect_left(ended_s, begun.time_s - longest_s), bisect_right(ended_s, begun.time_s + longest_s))
        if any(_goes_on(end, begun, config) for end in ended[near]):
            broken.append(track)
    return frozenset(broken)


@dataclass(frozen=True, eq=False)
class _Way:
    """Where a track was: times (N,), s, and places (N, 2), m."""

    times_s: FloatArray
    places: FloatArray


@dataclass(frozen=True, eq=False)
class _Edge:
    """The beginning or the end of a track: when, s, where, (2,) m, and how fast, (2,) m/s."""

    time_s: float
    place: FloatArray
    velocity: FloatArray


def _beginning(way: _Way) -> _Edge:
    own = way.times_s - way.times_s[0] <= _VELOCITY_S
    return _Edge(float(way.times_s[0]), way.places[0], _velocity(way.times_s[own], way.places[own]))


def _end(way: _Way) -> _Edge:
    own = way.times_s[-1] - way.times_s <= _VELOCITY_S
    return _Edge(float(way.times_s[-1]), way.places[-1], _velocity(way.times_s[own], way.places[own]))


def _velocity(times_s: FloatArray, places: FloatArray) -> FloatArray:
    """(2,) m/s; 0 of a single sighting."""
    span_s = times_s[-1] - times_s[0]
    return (places[-1] - places[0]) / span_s if span_s > 0 else np.zeros(2)


def _ways(instants: Sequence[AnnotatedInstant]) -> dict[int, _Way]:
    seen: dict[int, list[tuple[float, float, float]]] = {}
    for instant in instants:
        for vehicle in instant.vehicles:
            if vehicle.track_id >= 0:
                seen.setdefault(vehicle.track_id, []).append((instant.time_ns * 1e-9, vehicle.x_m, vehicle.y_m))
    arrays = {track: np.array(rows) for track, rows in seen.items()}
    return {track: _Way(rows[:, 0], rows[:, 1:]) for track, rows in arrays.items()}


def _goes_on(ended: _Edge, begun: _Edge, config: AssociateConfig) -> bool:
    hidden_s = abs(begun.time_s - ended.time_s)
    speed_before, speed_after = float(np.linalg.norm(ended.velocity)), float(np.linalg.norm(begun.velocity))
    speed = max(speed_before, speed_after)
    stands = speed < _STANDING_MPS
    if hidden_s > (config.max_hidden_standing_s if stands else config.max_hidden_moving_s):
        return False
    way = begun.place - ended.place
    ahead_m = float(way @ ended.velocity) / max(speed_before, _STANDING_MPS)
    reach_m = _UNCERTAIN_M + (0.0 if stands else speed * hidden_s)
    return float(np.linalg.norm(way)) <= reach_m and ahead_m >= -_UNCERTAIN_M
