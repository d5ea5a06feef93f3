"""Which tracks can come into conflict, and at which instants: a cheap test of distance before the exact measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import LENGTH, WIDTH, XY
from wibam_core.scene import Track


@dataclass(frozen=True, eq=False)
class PairInstants:
    """The common instants of two tracks.

    Attributes:
        index_a, index_b: (K,) indices into the two tracks, in time order.
        consecutive: (K,) whether no instant of either track lies between this one and the one before.
    """

    index_a: NDArray[np.int64]
    index_b: NDArray[np.int64]
    consecutive: NDArray[np.bool_]


def pair_instants(tracks: Sequence[Track], horizon_s: float) -> dict[tuple[int, int], PairInstants]:
    """Pairs of tracks, by their ids (smaller first), whose paths come within reach of each other.

    Kept are pairs whose bounding rectangles of all positions, grown by their sizes and by what they drive within
    ``horizon_s`` at their top speed, meet, and that share at least one instant or follow within ``horizon_s``.
    """
    ordered = sorted(tracks, key=lambda track: track.track_id)
    low, high, begin, end = _bounds(ordered, horizon_s)
    horizon_ns = int(horizon_s * 1e9)
    pairs = {}
    for i, j in combinations(range(len(ordered)), 2):
        apart_in_time = begin[i] > end[j] + horizon_ns or begin[j] > end[i] + horizon_ns
        if apart_in_time or (low[i] > high[j]).any() or (low[j] > high[i]).any():
            continue
        a, b = ordered[i], ordered[j]
        _, index_a, index_b = np.intersect1d(a.times_ns, b.times_ns, assume_unique=True, return_indices=True)
        step = (np.diff(index_a) == 1) & (np.diff(index_b) == 1)
        pairs[a.track_id, b.track_id] = PairInstants(index_a, index_b, np.r_[False, step][: len(index_a)])
    return pairs


def _bounds(
    tracks: Sequence[Track], horizon_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], list[int], list[int]]:
    low, high = np.empty((len(tracks), 2)), np.empty((len(tracks), 2))
    for k, track in enumerate(tracks):
        reach = 0.5 * np.hypot(track.boxes[:, LENGTH], track.boxes[:, WIDTH]).max()
        reach += horizon_s * np.hypot(*track.velocities_mps.T).max()
        low[k], high[k] = track.boxes[:, XY].min(axis=0) - reach, track.boxes[:, XY].max(axis=0) + reach
    return low, high, [int(t.times_ns[0]) for t in tracks], [int(t.times_ns[-1]) for t in tracks]
