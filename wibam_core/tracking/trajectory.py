"""From the boxes that belong to each vehicle to its smooth 7DoF track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import POSE, SIZE, XY, YAW, Z
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import CLASSES
from wibam_core.scene import Track
from wibam_core.tracking.fusion import SD_FLOOR
from wibam_core.tracking.models import model_of
from wibam_core.tracking.motion import YAW as STATE_YAW
from wibam_core.tracking.motion import Measurement, transposed
from wibam_core.tracking.smoother import smooth

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: A vehicle that drove at least this far shows by its motion where its front is.
_MIN_DRIVEN_M = 2.0
#: A camera errs in much the same way in one frame and the next, while the smoother takes errors for independent. So
#: what is measured counts for less than it says: factors of the variances of x, y and yaw. Who walks turns at once, and
#: is not taken for somebody who drives on.
_LASTING = np.array([3.0, 3.0, 3.0])
#: Of somebody who brakes or starts hard, that would hide how hard: what lasts moves nobody, and what is measured anew
#: at each instant is more exact than the whole.
_BRISK = np.array([0.7, 0.7, 1.0])
#: Hard is a change of speed by more than this, m/s²; so much around it counts as well, s.
_BRISK_MPS2, _BRISK_AROUND_S = 3.0, 0.5
#: One that drives stands while it is slower than this for so long, m/s and s, and gets nowhere meanwhile (m).
_RESTING_MPS, _RESTING_S, _CREPT_M = 0.3, 2.0, 0.5
#: What comes out is less certain than the smoother says: its variances, as multiples of what they are for independent
#: errors (benchmarks/tracking.py, where half of the variance persists; benchmarks/conflicts.py).
_LEFT = np.array([4.5, 4.5, 6.6])
#: The same for one that stands: all that is measured of it is of one place, and errs in one way for long.
_LEFT_STANDING = 45.0
#: So many vehicles are smoothed together; all that is known of their states at every instant is in memory meanwhile.
_TOGETHER = 64
#: So many times the fewest hits, seen often enough, prove a road user for good.
_MANY = 3
#: Somebody slower than this may be stepping back or aside, m/s.
_WALKING_MPS = 0.5


@dataclass(frozen=True, eq=False)
class Hit:
    """A vehicle's fused box at one instant.

    Attributes:
        box, sd: (7,). votes: (C,) by class. headings: (2,) votes for the box's yaw and for the opposite one.
    """

    time_ns: int
    box: Array
    sd: Array
    votes: Array
    headings: Array

    @property
    def measurement(self) -> Measurement:
        """Its place and heading."""
        return Measurement(self.box[POSE], self.sd[POSE])


def seen_often(hits: Sequence[Hit], instants: Indices, fewest: int, share: float) -> bool:
    """Whether a road user was seen ``fewest`` times and at such a share of the instants that it lasted; or at some time
    by many hits in a row: who parked in full view may be seen now and then only, once others stand in front."""
    if len(hits) < fewest:
        return False
    at = np.searchsorted(instants, [hit.time_ns for hit in hits])
    if len(hits) >= share * (at[-1] - at[0] + 1):
        return True
    many = _MANY * fewest
    return len(hits) >= many and bool((many >= share * (at[many - 1 :] - at[: len(at) - many + 1] + 1)).any())


def came_nowhere(hits: Sequence[Hit], least_s: float, slowest_mps: float) -> bool:
    """Whether somebody was unseen for longer than ``least_s`` between two hits, and hardly elsewhere afterwards."""
    if len(hits) < 2 or hits[1].time_ns - hits[0].time_ns <= least_s * 1e9:
        return False
    way_m = float(np.hypot(*(hits[1].box[XY] - hits[0].box[XY])))
    return way_m < slowest_mps * (hits[1].time_ns - hits[0].time_ns) * 1e-9


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
    model = model_of(classes, size[:, 0])
    begin = np.searchsorted(instants, [hits[0].time_ns for hits in vehicles])
    lengths = np.searchsorted(instants, [hits[-1].time_ns for hits in vehicles], side="right") - begin
    of_state = np.repeat(np.arange(len(vehicles)), lengths)
    start = np.cumsum(lengths) - lengths
    times_ns = instants[np.arange(len(of_state)) + (begin - start)[of_state]]

    measured, value, sd = np.zeros(len(of_state), bool), np.zeros((len(of_state), 3)), np.ones((len(of_state), 3))
    for at, since, hits in zip(start, begin, vehicles, strict=True):
        rows = at - since + np.searchsorted(instants, [hit.time_ns for hit in hits])
        measured[rows] = True
        value[rows] = np.array([hit.box for hit in hits])[:, POSE]
        sd[rows] = np.array([hit.sd for hit in hits])[:, POSE]
    states = [slice(at, at + length) for at, length in zip(start, lengths, strict=True)]
    drives = ~model.turns_freely[of_state]
    factors = np.where(drives[:, None], _BRISK, 1.0)
    stands = np.zeros(len(of_state), bool)
    beliefs = smooth(model, lengths, times_ns, Measurement(value, np.sqrt(factors) * sd), measured, stands)
    speeds = model.where(of_state).travel(beliefs.mean)[1]
    brisk = np.concatenate([_is_brisk(speeds[own], times_ns[own]) for own in states])
    factors[drives & ~brisk] = _LASTING
    beliefs = smooth(model, lengths, times_ns, Measurement(value, np.sqrt(factors) * sd), measured, stands)
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
        value[start[turned], STATE_YAW] = beliefs.mean[start[turned], STATE_YAW] + np.pi
        factors[stands] = _LASTING
        rows = np.flatnonzero(anew[of_state])
        again = smooth(
            model.where(anew),
            lengths[anew],
            times_ns[rows],
            Measurement(value, np.sqrt(factors) * sd).where(rows),
            measured[rows],
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
    left = np.where(stands[:, None], _LEFT_STANDING, _LEFT)
    sd[:, POSE] = np.sqrt(left / factors * np.maximum(variances, 0.0))
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


def _is_brisk(speeds: Array, times_ns: Indices) -> NDArray[np.bool_]:
    """(T,) when a vehicle with these speeds (T,) brakes or starts hard, with what lies around it."""
    changes = np.abs(np.diff(speeds)) > _BRISK_MPS2 * np.diff(times_ns) * 1e-9
    hard_ns = times_ns[1:][changes]
    if not len(hard_ns):
        return np.zeros(len(speeds), bool)
    after = np.searchsorted(hard_ns, times_ns)
    gaps = [np.abs(times_ns - hard_ns[np.clip(k, 0, len(hard_ns) - 1)]) for k in (after - 1, after)]
    return np.asarray(np.minimum(*gaps) <= _BRISK_AROUND_S * 1e9)


def _stands(speeds: Array, times_ns: Indices) -> NDArray[np.bool_]:
    """(T,) when a vehicle with these speeds (T,) along its heading stands."""
    slow = np.abs(speeds) < _RESTING_MPS
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
