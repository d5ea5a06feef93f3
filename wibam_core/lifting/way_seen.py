"""How much of the way that a track claims is seen in pictures: what its boxes move within one and the same view.

A place jumps, with nobody moving, whenever another camera begins to see a vehicle, another vehicle covers a side of it,
or a box goes over to the next one in a queue. A vehicle that drives moves all edges of its box in every picture, all
the time; a place that jumps because cameras change moves none of them, one that jumps because a side is covered moves
one, and one that goes over to another vehicle moves them once. So the edges of one camera's boxes are compared from
sighting to sighting with what the claimed way would have moved them, and what the middle one says is believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from wibam_core.geometry.camera import Camera
from wibam_core.lifting.observations import Observations
from wibam_core.lifting.trajectory import Motion, Tracks
from wibam_core.scene import FloatArray

#: The middle of a vehicle is about this high above the ground, m.
_MIDDLE_M = 0.7
#: Of the sightings by one camera around a moment at most so many are compared, evenly spread, each with the next.
_MOST_SIGHTINGS = 9
#: An edge that should have moved by more than this many of its standard deviations counts no more than one that should
#: by so many: else one jump would count more than all the moments at which a vehicle stood.
_ENOUGH_SD = 3.0
#: Points nearer to a camera than this along its axis are not projected, m.
_NEAREST_M = 0.5


class _View(NamedTuple):
    """Sightings of one vehicle by one camera: times (K,), box edges and their s.d. (K, 4) px, whether they are the
    vehicle's own (K, 4), and where the smoothed place lies in the image: (K, 2) px and depth (K,) m."""

    times_s: FloatArray
    edges: FloatArray
    sd: FloatArray
    exact: np.ndarray
    middle: FloatArray
    depth: FloatArray


def share_seen(
    seen: Observations,
    cameras: Sequence[Camera],
    tracks: Tracks,
    motion: Motion,
    wanted: np.ndarray,
    half_window_s: float,
) -> FloatArray:
    """(M, T) share, 0 to 1, of the way that tracks make around each moment which the pictures confirm.

    How far each edge moved from one sighting by a camera to its next one, over how far the claimed way would have moved
    it, is a vote for that share, and its weight is the latter in standard deviations, up to `_ENOUGH_SD`. The share is
    the weighted median; 1 where no camera saw the vehicle twice, and where it is not wanted.

    Args:
        seen: the N observations, whose places count from the same origin as the cameras.
        cameras: of the rig, in its order.
        tracks: how the observations form M tracks of at most T.
        motion: their smoothed motion.
        wanted: (M, T) of which moments.
        half_window_s: sightings so long before and after a moment are compared.
    """
    share = np.ones(tracks.valid.shape)
    for k, count in enumerate(tracks.valid.sum(axis=1)):
        rows, times = tracks.rows[k, :count], tracks.times_s[k, :count]
        moments = np.flatnonzero(wanted[k, :count])
        if not len(moments):
            continue
        views = _views(seen, cameras, rows, times, motion.position[k, :count])
        for t in moments:
            share[k, t] = _middle(views, times[t], half_window_s)
    return share


def _views(
    seen: Observations, cameras: Sequence[Camera], rows: np.ndarray, times_s: FloatArray, places: FloatArray
) -> list[_View]:
    views = []
    for number, camera in enumerate(cameras):
        at, slot = np.nonzero(seen.seen[rows] & (seen.cameras[rows] == number))
        inside = camera.to_camera(np.column_stack([places[at], np.full(len(at), _MIDDLE_M)]))
        near = inside[:, 2] < _NEAREST_M
        at, slot, inside = at[~near], slot[~near], inside[~near]
        if len(at) < 2:
            continue
        of = rows[at], slot
        middle = camera.project_camera_points(inside)
        views.append(_View(times_s[at], seen.boxes[of], seen.edge_sd[of], seen.exact[of], middle, inside[:, 2]))
    return views


def _middle(views: Sequence[_View], now_s: float, half_window_s: float) -> float:
    """The weighted median of what edges moved over what they should have moved."""
    moved, expected, sd = [], [], []
    for view in views:
        begin, end = np.searchsorted(view.times_s, [now_s - half_window_s - 1e-6, now_s + half_window_s + 1e-6])
        few = min(end - begin, _MOST_SIGHTINGS)
        if few < 2:
            continue
        chosen = np.linspace(begin, end - 1, few).round().astype(np.int64)
        first, last = chosen[:-1], chosen[1:]
        own = view.exact[first] & view.exact[last]
        larger = (view.depth[first] / view.depth[last])[:, None]
        around = view.edges[first] - np.tile(view.middle[first], 2)
        should = np.tile(view.middle[last], 2) + larger * around - view.edges[first]
        moved.append((view.edges[last] - view.edges[first])[own])
        expected.append(should[own])
        sd.append(np.hypot(view.sd[first], view.sd[last])[own])
    if not moved:
        return 1.0
    way = np.concatenate(expected)
    weight = np.minimum(np.abs(way) / np.concatenate(sd), _ENOUGH_SD)
    told = weight > 1e-6
    if not told.any():
        return 1.0
    ratio, weight = np.concatenate(moved)[told] / way[told], weight[told]
    order = np.argsort(ratio)
    half = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(np.clip(ratio[order[half]], 0.0, 1.0))
