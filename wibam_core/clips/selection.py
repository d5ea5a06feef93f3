"""Which states a clip draws: the rules of the API's question about tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.documents.clips import ClipSpec
from wibam_core.geometry.box3d import XY
from wibam_core.scene import Track

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Moment:
    """The road users that are drawn at one time.

    Attributes:
        time_ns: reference clock.
        tracks: theirs.
        rows: (N,) of each one's track, the state at this time.
    """

    time_ns: int
    tracks: tuple[Track, ...]
    rows: NDArray[np.int64]


def moments(tracks: Sequence[Track], spec: ClipSpec) -> list[Moment]:
    """All times of the stretch at which anybody was tracked, ascending, with those who pass."""
    at: dict[int, list[tuple[Track, int]]] = {}
    for track in tracks:
        first, last = np.searchsorted(track.times_ns, [spec.start_ns, spec.end_ns])
        drawn = passes(track, spec)
        for row in range(int(first), int(last)):
            there = at.setdefault(int(track.times_ns[row]), [])
            if drawn[row]:
                there.append((track, row))
    return [
        Moment(time_ns, tuple(track for track, _ in there), np.array([row for _, row in there], np.int64))
        for time_ns, there in sorted(at.items())
    ]


def passes(track: Track, spec: ClipSpec) -> NDArray[np.bool_]:
    """(T,) which states of a track are drawn."""
    drawn = (track.times_ns >= spec.start_ns) & (track.times_ns < spec.end_ns)
    if spec.classes and track.vehicle_class not in spec.classes:
        drawn &= False
    if spec.min_speed_mps is not None:
        drawn &= np.hypot(*track.velocities_mps.T) >= spec.min_speed_mps
    if spec.polygon:
        drawn &= inside(spec.polygon, track.boxes[:, XY])
    return np.asarray(drawn)


def inside(polygon: ArrayLike, points: Array) -> NDArray[np.bool_]:
    """(N,) which points (N, 2) lie in a polygon (K, 2), by the even-odd rule: a ray along +X crosses its edges an odd
    number of times."""
    corners = np.asarray(polygon, dtype=np.float64)
    odd = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if y0 != y1:
            across = (points[:, 1] >= y0) != (points[:, 1] >= y1)
            odd ^= across & (points[:, 0] < x0 + (points[:, 1] - y0) * ((x1 - x0) / (y1 - y0)))
    return odd
