"""Tracks of one vehicle that was hidden in between, made one.

A track ends where its vehicle is seen no longer: behind a truck, or at a red light behind those that wait in front.
Where another track begins, later and where the first one's vehicle must be by then, it is taken for the same vehicle.
All such pairs are chosen together, by the cheapest assignment of ends to beginnings (Huang, Wu & Nevatia, "Robust
object tracking by hierarchical association of detection responses", ECCV 2008).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wibam_core.config import AssociateConfig
from wibam_core.road_users import VULNERABLE
from wibam_core.scene import FloatArray, IntArray

#: The end of a track is what was seen of it within this time.
_END_S = 1.5
#: Standard deviation of a speed, along each axis, before anything of the vehicle was seen.
_USUAL_SPEED_MPS = 10.0
#: A vehicle stands if it is slower than this, as far as one can say: give or take the standard deviation of its speed,
#: which counts as this at most.
_STANDING_MPS = 1.0
#: A moving vehicle is expected where the mean of its velocities before and after takes it. Standard deviation of the
#: acceleration that leads it elsewhere, of the mean acceleration from the one velocity to the other, which are those of
#: the middles of what was seen before and after, and of a velocity.
_ACCELERATION_MPS2, _MEAN_ACCELERATION_MPS2, _SPEED_SD_MPS = 1.0, 2.0, 1.5
#: Standard deviation of how far a standing vehicle creeps while it is hidden.
_CREEP_M = 0.6
#: Costs are twice a negative log-likelihood: that of a second of being hidden, and of a change of class.
_COST_PER_S, _CLASS_CHANGE_COST = 0.1, 2.0
#: A track is not gone on with by one that begins more than so many standard deviations off, nor where that costs more.
_GATE_SD, _MOST_COST = 2.0, 4.5


@dataclass(frozen=True, eq=False)
class Sightings:
    """What is seen at one instant.

    Attributes:
        times_ns: (N,) when each position holds. positions: (N, 2), m. sd_m: (N,) of the positions.
        classes: (N,) class indices; a change of class makes it less likely that a vehicle is the same, and between
            vehicles and people on foot or on two wheels there is none.
    """

    times_ns: IntArray
    positions: FloatArray
    sd_m: FloatArray
    classes: IntArray


class _Ends(NamedTuple):
    """First or last moments of T tracks.

    Attributes:
        times_s: (T,). positions: (T, 2) m. sd_m: (T,) of the positions.
        velocities: (T, 2) m/s, the mean of what was seen about then. speed_sd_mps: (T,) of either component.
        velocity_times_s: (T,) the middle of the time that this mean is of.
    """

    times_s: FloatArray
    positions: FloatArray
    sd_m: FloatArray
    velocities: FloatArray
    speed_sd_mps: FloatArray
    velocity_times_s: FloatArray


def stitch(instants: Sequence[Sightings], tracks: Sequence[IntArray], config: AssociateConfig) -> list[IntArray]:
    """Give tracks that show the same vehicle one id.

    Args:
        instants: in order of time.
        tracks: for every instant (N,) the track of each sighting, from 0 on.
        config: how fast vehicles are, and for how long one may be hidden; what that costs mostly ends it sooner.

    Returns:
        The same with the ids anew, 0, 1, ...; −1 for what is seen at one instant only.
    """
    sightings = np.bincount(np.concatenate([*tracks, np.empty(0, np.int64)]))
    kept = sightings > 1
    number = np.where(kept, np.cumsum(kept) - 1, -1)
    tracks = [number[own] for own in tracks]
    count = int(kept.sum())
    if count < 2:
        return tracks
    ids = np.concatenate(tracks)
    times_ns = np.concatenate([seen.times_ns for seen in instants])
    order = np.lexsort((times_ns, ids))
    rows = np.split(order, np.searchsorted(ids[order], np.arange(count)))[1:]  # without what is in no track
    times_s = (times_ns - times_ns.min()) * 1e-9
    positions = np.concatenate([seen.positions for seen in instants])
    sd_m = np.concatenate([seen.sd_m for seen in instants])
    classes = np.concatenate([seen.classes for seen in instants])
    usual = np.array([np.bincount(classes[own]).argmax() for own in rows])

    def ends_at(which: int) -> _Ends:
        return _Ends(
            *(np.array(of) for of in zip(*(_end(own, which, times_s, positions, sd_m) for own in rows), strict=True))
        )

    ends, begins = ends_at(-1), ends_at(0)
    longest_s = max(config.max_hidden_moving_s, config.max_hidden_standing_s)
    earlier, later = _candidates(ends.times_s, begins.times_s, longest_s)
    cost = _costs(_of(ends, earlier), _of(begins, later), config)
    cost += _CLASS_CHANGE_COST * (usual[earlier] != usual[later])
    cost[VULNERABLE[usual[earlier]] != VULNERABLE[usual[later]]] = np.inf
    near = cost <= _MOST_COST
    earlier, later = _matched(earlier[near], later[near], cost[near] - _MOST_COST - 1e-9, count)
    name = np.arange(count)
    before = dict(zip(later.tolist(), earlier.tolist(), strict=True))
    for track in np.argsort([times_s[own[0]] for own in rows], kind="stable").tolist():
        if track in before:
            name[track] = name[before[track]]
    name = np.unique(name, return_inverse=True)[1]
    return [np.where(own >= 0, name[own], -1) for own in tracks]


def _of(ends: _Ends, rows: IntArray) -> _Ends:
    return _Ends(*(of[rows] for of in ends))


def _candidates(end_s: FloatArray, begin_s: FloatArray, longest_s: float) -> tuple[IntArray, IntArray]:
    """Pairs of tracks of which the second begins (T,) after the first ends (T,), at most ``longest_s`` after."""
    order = np.argsort(begin_s, kind="stable")
    first = np.searchsorted(begin_s[order], end_s, side="right")
    last = np.searchsorted(begin_s[order], end_s + longest_s, side="right")
    earlier = np.repeat(np.arange(len(end_s)), last - first)
    later = [order[a:b] for a, b in zip(first, last, strict=True)]
    return earlier, np.concatenate([*later, np.empty(0, np.int64)])


def _matched(earlier: IntArray, later: IntArray, cost: FloatArray, count: int) -> tuple[IntArray, IntArray]:
    """Pairs of them, each track once as the earlier and once as the later, that cost least together; all costs are < 0.

    Pairs that no chain of candidates connects do not compete, so that long recordings need no large table.
    """
    graph = coo_array((np.ones(len(cost)), (earlier, count + later)), shape=(2 * count, 2 * count))
    part = connected_components(graph, directed=False)[1][earlier]
    order = np.argsort(part, kind="stable")
    found = []
    for own in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        rows, row = np.unique(earlier[own], return_inverse=True)
        columns, column = np.unique(later[own], return_inverse=True)
        table = np.zeros((len(rows), len(columns)))
        table[row, column] = cost[own]
        chosen = linear_sum_assignment(table)
        good = table[chosen] < 0
        found.append((rows[chosen[0][good]], columns[chosen[1][good]]))
    return np.concatenate([of for of, _ in found]), np.concatenate([of for _, of in found])


def _end(
    own: IntArray, which: int, times_s: FloatArray, positions: FloatArray, sd_m: FloatArray
) -> tuple[float, FloatArray, float, FloatArray, float, float]:
    """The first (0) or last (−1) moment, as in `_Ends`, of a track with the rows ``own``: on a straight line through
    what was seen about then."""
    at = float(times_s[own[which]])
    own = own[np.abs(times_s[own] - at) <= _END_S]
    design = np.stack([np.ones(len(own)), times_s[own] - at], axis=1)
    weighted = design / sd_m[own, None] ** 2
    information = design.T @ weighted + np.diag([0.0, _USUAL_SPEED_MPS**-2.0])
    place, velocity = np.linalg.solve(information, weighted.T @ positions[own])
    speed_sd = float(np.sqrt(np.linalg.inv(information)[1, 1]))
    return at, place, float(np.median(sd_m[own])), velocity, speed_sd, float(times_s[own].mean())


def _costs(ends: _Ends, begins: _Ends, config: AssociateConfig) -> FloatArray:
    """(P,) of P pairs: what it costs to take a track that ends for the one that begins; infinite where it cannot be."""
    hidden_s = begins.times_s - ends.times_s
    moved = begins.positions - ends.positions
    variance = ends.sd_m**2 + begins.sd_m**2
    far = np.linalg.norm(moved, axis=1) > config.max_speed_mps * hidden_s + _GATE_SD * np.sqrt(variance)
    slowest = [_STANDING_MPS + np.minimum(of.speed_sd_mps, _STANDING_MPS) for of in (ends, begins)]
    slow = [np.linalg.norm(of.velocities, axis=1) < mps for of, mps in zip((ends, begins), slowest, strict=True)]
    mean_velocity = 0.5 * (ends.velocities + begins.velocities)
    change = np.square(begins.velocities - ends.velocities).sum(axis=1)
    between_s = begins.velocity_times_s - ends.velocity_times_s
    change /= _SPEED_SD_MPS**2 + (_MEAN_ACCELERATION_MPS2 * between_s) ** 2
    ways = (
        (slow[0] & slow[1] & (hidden_s <= config.max_hidden_standing_s), moved, _CREEP_M, 0.0),
        (
            hidden_s <= config.max_hidden_moving_s,
            moved - mean_velocity * hidden_s[:, None],
            0.5 * _ACCELERATION_MPS2 * hidden_s**2,
            change,
        ),
    )
    best = np.full(len(hidden_s), np.inf)
    for possible, off, spread_m, faster in ways:
        own = variance + spread_m**2
        squared = np.square(off).sum(axis=1) / own + faster
        # near beginnings that are equally likely: the more certain one wins, as in the Gaussian likelihood
        cost = squared + 2 * np.log(own) + _COST_PER_S * hidden_s
        best = np.where(possible & ~far & (squared <= _GATE_SD**2), np.minimum(best, cost), best)
    return best
