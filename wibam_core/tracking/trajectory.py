"""From the boxes that belong to each vehicle to its smooth 7DoF track."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import POSE, SIZE, XY, YAW, Z
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import CLASSES
from wibam_core.scene import Track
from wibam_core.tracking.fusion import SD_FLOOR
from wibam_core.tracking.hits import Hit
from wibam_core.tracking.models import steady_model_of
from wibam_core.tracking.motion import YAW as STATE_YAW
from wibam_core.tracking.motion import Measurement, transposed
from wibam_core.tracking.smoother import Views, smooth

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: A vehicle that drove at least this far shows by its motion where its front is.
_MIN_DRIVEN_M = 2.0
#: One that drives stands while it is slower than this for so long, m/s and s, and gets nowhere meanwhile (m).
_RESTING_MPS, _RESTING_S, _CREPT_M = 0.3, 2.0, 0.5
#: Between two such times it stands, too, if it seems no faster than this, for so long at most, m/s and s.
_SWAYING_MPS, _SWAYING_S = 0.8, 1.0
#: What comes out is less certain than the smoother says, since networks make some large errors and state none of them:
#: a factor of the variances. And cameras err alike: standard deviations of x, y and yaw that no view takes away, m and
#: rad, on the move and of one that stands (benchmarks/conflicts.py, whose network errs as one on rendered sites).
_LEFT = 2.25
_SHARED_SD, _SHARED_STANDING_SD = np.array([0.08, 0.08, 0.02]), np.array([0.13, 0.13, 0.02])
#: No camera knows a place or a heading better than this, whatever it states, m and rad.
_VIEW_SD = np.array([0.1, 0.1, 0.05])
#: So many vehicles are smoothed together; all that is known of their states at every instant is in memory meanwhile.
_TOGETHER = 16
#: Somebody slower than this may be stepping back or aside, m/s.
_WALKING_MPS = 0.5


def to_tracks(vehicles: Sequence[Sequence[Hit]], instants: Indices) -> list[Track]:
    """Smooth each vehicle's boxes (in time order), with a state at each of the instants from its first to its last box.

    A vehicle has one size, the weighted median over time, and stands on the ground. Its front is where its motion says;
    for one that hardly moved, where most views saw it. Tracks are numbered in the order of the vehicles.
    """
    return [
        track
        for first in range(0, len(vehicles), _TOGETHER)
        for track in _smoothed(first, vehicles[first : first + _TOGETHER], instants)
    ]


def _smoothed(first_id: int, vehicles: Sequence[Sequence[Hit]], instants: Indices) -> list[Track]:
    size, size_sd = (np.array(of) for of in zip(*(_size(hits) for hits in vehicles), strict=True))
    classes = np.array([np.sum([hit.votes for hit in hits], axis=0).argmax() for hits in vehicles])
    model, accelerations = steady_model_of(classes, size[:, 0])
    begin = np.searchsorted(instants, [hits[0].time_ns for hits in vehicles])
    lengths = np.searchsorted(instants, [hits[-1].time_ns for hits in vehicles], side="right") - begin
    of_state = np.repeat(np.arange(len(vehicles)), lengths)
    start = np.cumsum(lengths) - lengths
    times_ns = instants[np.arange(len(of_state)) + (begin - start)[of_state]]
    first = Measurement(
        np.array([hits[0].box[POSE] for hits in vehicles]), np.array([hits[0].sd[POSE] for hits in vehicles])
    )
    seen_at = [at - since + np.searchsorted(instants, [hit.time_ns for hit in hits])
               for at, since, hits in zip(start, begin, vehicles, strict=True)]  # fmt: skip
    views = _views(vehicles, seen_at, len(of_state))
    states = [slice(at, at + length) for at, length in zip(start, lengths, strict=True)]
    drives = ~model.turns_freely[of_state]
    stands = np.zeros(len(of_state), bool)
    beliefs = smooth(model, accelerations, lengths, times_ns, first, views, stands)
    speeds = model.where(of_state).travel(beliefs.mean)[1]
    turned = np.array(
        [
            _is_reversed(speeds[own], beliefs.mean[own, STATE_YAW], times_ns[own], hits)
            for own, hits in zip(states, vehicles, strict=True)
        ]
    )
    stands = drives & np.concatenate([_stands(speeds[own], times_ns[own]) for own in states])
    anew = turned | np.logical_or.reduceat(stands, start)
    if anew.any():
        first.value[turned, STATE_YAW] = beliefs.mean[start[turned], STATE_YAW] + np.pi
        rows, who = np.flatnonzero(anew[of_state]), np.flatnonzero(anew)
        again = smooth(
            model.where(who),
            accelerations[who],
            lengths[who],
            times_ns[rows],
            first.where(who),
            views.where(rows),
            stands[rows],
        )
        beliefs.mean[rows], beliefs.covariance[rows] = again.mean, again.covariance

    every = model.where(of_state)
    place, H = every.centre(beliefs.mean)
    travel, ahead = every.travel(beliefs.mean)
    for own in (states[number] for number in np.flatnonzero(model.turns_freely)):
        place[own, STATE_YAW] = _facing(place[own, STATE_YAW], np.hypot(*travel[own].T), ahead[own])
    variances = np.diagonal(H @ beliefs.covariance @ transposed(H), axis1=1, axis2=2)
    boxes, sd = np.empty((len(of_state), 7)), np.empty((len(of_state), 7))
    boxes[:, XY], boxes[:, YAW] = place[:, :STATE_YAW], normalise_angle(place[:, STATE_YAW])
    boxes[:, SIZE], boxes[:, Z] = size[of_state], size[of_state, 2] / 2
    shared = np.where(stands[:, None], _SHARED_STANDING_SD, _SHARED_SD)
    sd[:, POSE] = np.hypot(np.sqrt(_LEFT * np.maximum(variances, 0.0)), shared)
    sd[:, SIZE], sd[:, Z] = size_sd[of_state], size_sd[of_state, 2] / 2
    sd = np.maximum(sd, SD_FLOOR / 3)
    velocities, yaw_rates = every.velocity(beliefs.mean)
    return [
        Track(
            first_id + number,
            CLASSES[classes[number]],
            times_ns[own],
            boxes[own],
            sd[own],
            velocities[own],
            yaw_rates[own],
        )
        for number, own in enumerate(states)
    ]


def _views(vehicles: Sequence[Sequence[Hit]], rows: Sequence[Indices], count: int) -> Views:
    """What cameras saw of each vehicle, of which these are the rows with hits, of ``count``. Each numbers its own
    cameras, so that there are no more than those that saw one of them."""
    of_each = [np.unique(np.concatenate([hit.cameras for hit in hits]), return_inverse=True) for hits in vehicles]
    shape = count, max(len(cameras) for cameras, _ in of_each)
    values, sd, seen = np.zeros((*shape, 3)), np.ones((*shape, 3)), np.zeros(shape, bool)
    for hits, own, (_, columns) in zip(vehicles, rows, of_each, strict=True):
        at = np.repeat(own, [len(hit.cameras) for hit in hits]), columns
        values[at] = np.concatenate([hit.poses for hit in hits])
        sd[at] = np.hypot(np.concatenate([hit.pose_sd for hit in hits]), _VIEW_SD)
        seen[at] = True
    return Views(values, sd, seen)


def _size(hits: Sequence[Hit]) -> tuple[Array, Array]:
    """Weighted median of length, width and height (3,), and its standard deviation (3,)."""
    sizes = np.array([hit.box[SIZE] for hit in hits])
    weights = 1.0 / np.array([hit.sd[SIZE] for hit in hits]) ** 2
    order = np.argsort(sizes, axis=0)
    cumulative = np.cumsum(np.take_along_axis(weights, order, axis=0), axis=0)
    middle = (cumulative >= 0.5 * cumulative[-1]).argmax(axis=0)
    median = np.take_along_axis(sizes, order, axis=0)[middle, np.arange(3)]
    spread = 1.4826 * np.median(np.abs(sizes - median), axis=0)
    return median, np.hypot(spread / np.sqrt(len(hits)), SD_FLOOR[SIZE])


def _stands(speeds: Array, times_ns: Indices) -> NDArray[np.bool_]:
    """(T,) when a vehicle with these speeds (T,) along its heading stands."""
    slow = np.abs(speeds) < _RESTING_MPS
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]])))
    for end, next_first in zip(bounds[1:-1:2].tolist(), bounds[2::2].tolist(), strict=True):
        brief = times_ns[next_first] - times_ns[end - 1] <= _SWAYING_S * 1e9
        slow[end:next_first] = brief and np.abs(speeds[end:next_first]).max() < _SWAYING_MPS
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]])))
    stands = np.zeros(len(speeds), bool)
    way_m = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times_ns) * 1e-9)])
    for first, last in zip(bounds[::2].tolist(), (bounds[1::2] - 1).tolist(), strict=True):
        long = times_ns[last] - times_ns[first] >= _RESTING_S * 1e9
        stands[first : last + 1] = long and abs(way_m[last] - way_m[first]) < _CREPT_M
    return stands


def _facing(yaws: Array, speeds: Array, ahead: Array) -> Array:
    """Where somebody with these yaws (T,), speeds (T,) and speeds along the yaws (T,) looks: people walk forwards.

    Who stands looks about as when they last walked, or next will.
    """
    walking = np.flatnonzero(speeds >= _WALKING_MPS)
    if not len(walking):
        return yaws
    nearest = walking[np.abs(np.arange(len(yaws))[:, None] - walking).argmin(axis=1)]
    front = yaws[nearest] + np.where(ahead[nearest] >= 0, 0.0, np.pi)
    return np.where(np.cos(yaws - front) >= 0, yaws, yaws + np.pi)


def _is_reversed(speeds: Array, yaws: Array, times_ns: Indices, hits: Sequence[Hit]) -> bool:
    """Whether the smoothed yaws (T,) of a vehicle, which has these speeds (T,) along them, point to its rear."""
    driven = float(np.sum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times_ns) * 1e-9))
    if abs(driven) >= _MIN_DRIVEN_M:
        return driven < 0
    seen = np.searchsorted(times_ns, [hit.time_ns for hit in hits])
    agrees = np.cos(np.array([hit.box[YAW] for hit in hits]) - yaws[seen]) >= 0
    headings = np.array([hit.headings for hit in hits])
    return float(((headings[:, 0] - headings[:, 1]) * np.where(agrees, 1.0, -1.0)).sum()) < 0
