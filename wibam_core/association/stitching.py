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

from wibam_core.scene import FloatArray, IntArray

#: The end of a track is what was seen of it within this time.
_END_S = 1.5
_USUAL_SPEED_MPS = 10.0
#: A vehicle slower than this stands.
_STANDING_MPS = 1.0
#: How long a moving and a standing vehicle may be hidden.
_LONGEST_MOVING_S, _LONGEST_STANDING_S = 3.0, 45.0
#: S.d. of a moving vehicle's acceleration meanwhile, about the mean of both ends' speeds and between them; of those
#: speeds; and of a standing vehicle's place.
_ACCELERATION_MPS2, _MEAN_ACCELERATION_MPS2, _SPEED_SD_MPS, _CREEP_M = 1.0, 2.0, 1.5, 0.6
#: What a second of being hidden costs, and a change of class; pairs are not made farther off than the gate, nor where
#: that and the spread of the places cost more than the most.
_COST_PER_S, _CLASS_CHANGE_COST = 0.1, 2.0
_GATE_SD, _MOST_COST = 2.0, 4.5
_REFUSED = 1e6


@dataclass(frozen=True, eq=False)
class Sightings:
    """What is seen at one instant.

    Attributes:
        times_ns: (N,) when each position holds. positions: (N, 2), m. sd_m: (N,) of the positions.
        classes: (N,) class indices; a change of class makes it less likely that a vehicle is the same.
    """

    times_ns: IntArray
    positions: FloatArray
    sd_m: FloatArray
    classes: IntArray


class _Ends(NamedTuple):
    """First or last moments of T tracks: times (T,) s, positions (T, 2) m, their s.d. (T,), velocities (T, 2) m/s."""

    times_s: FloatArray
    positions: FloatArray
    sd_m: FloatArray
    velocities: FloatArray


def stitch(instants: Sequence[Sightings], tracks: Sequence[IntArray], max_speed_mps: float) -> list[IntArray]:
    """Give tracks that show the same vehicle one id.

    Args:
        instants: in order of time.
        tracks: for every instant (N,) the track of each sighting, counted from 0 without one left out.
        max_speed_mps: no vehicle is faster.

    Returns:
        The same with the ids anew; −1 for what is seen at one instant only.
    """
    ids = np.concatenate([*tracks, np.empty(0, np.int64)])
    count = int(ids.max(initial=-1)) + 1
    if not count:
        return list(tracks)
    times_ns = np.concatenate([seen.times_ns for seen in instants])
    order = np.lexsort((times_ns, ids))
    rows = np.split(order, np.searchsorted(ids[order], np.arange(count)))[1:]
    times_s = (times_ns - times_ns.min()) * 1e-9
    positions = np.concatenate([seen.positions for seen in instants])
    sd_m = np.concatenate([seen.sd_m for seen in instants])
    classes = np.concatenate([seen.classes for seen in instants])
    usual = np.array([np.bincount(classes[own]).argmax() for own in rows])

    def ends_at(which: int) -> _Ends:
        return _Ends(
            *(np.array(of) for of in zip(*(_end(own, which, times_s, positions, sd_m) for own in rows), strict=True))
        )

    cost = _costs(ends_at(-1), ends_at(0), max_speed_mps)
    cost += _CLASS_CHANGE_COST * (usual[:, None] != usual)
    cost = np.where(cost <= _MOST_COST, cost - _MOST_COST, _REFUSED)
    earlier, later = linear_sum_assignment(np.minimum(cost, 0.0))
    good = cost[earlier, later] < 0
    name = np.arange(count)
    before = dict(zip(later[good].tolist(), earlier[good].tolist(), strict=True))
    for track in np.argsort([times_s[own[0]] for own in rows], kind="stable").tolist():
        if track in before:
            name[track] = name[before[track]]
    kept = np.bincount(name[ids], minlength=count) > 1
    number = np.where(kept, np.cumsum(kept) - 1, -1)
    return [number[name[own]] for own in tracks]


def _end(
    own: IntArray, which: int, times_s: FloatArray, positions: FloatArray, sd_m: FloatArray
) -> tuple[float, FloatArray, float, FloatArray]:
    """The first (0) or last (−1) moment, as in `_Ends`, of a track with the rows ``own``: on a straight line through
    what was seen about then."""
    at = float(times_s[own[which]])
    own = own[np.abs(times_s[own] - at) <= _END_S]
    design = np.stack([np.ones(len(own)), times_s[own] - at], axis=1)
    weighted = design / sd_m[own, None] ** 2
    information = design.T @ weighted + np.diag([0.0, _USUAL_SPEED_MPS**-2.0])
    place, velocity = np.linalg.solve(information, weighted.T @ positions[own])
    return at, place, float(np.median(sd_m[own])), velocity


def _costs(ends: _Ends, begins: _Ends, max_speed_mps: float) -> FloatArray:
    """(T, T) of taking a track (row) for the one that another (column) goes on with."""
    hidden_s = begins.times_s[None] - ends.times_s[:, None]
    moved = begins.positions[None] - ends.positions[:, None]
    variance = ends.sd_m[:, None] ** 2 + begins.sd_m[None] ** 2
    far = np.linalg.norm(moved, axis=-1) > max_speed_mps * hidden_s + _GATE_SD * np.sqrt(variance)
    slow = [np.linalg.norm(of.velocities, axis=1) < _STANDING_MPS for of in (ends, begins)]
    stands = slow[0][:, None] & slow[1][None] & (hidden_s <= _LONGEST_STANDING_S)
    mean_velocity = 0.5 * (ends.velocities[:, None] + begins.velocities[None])
    change = np.square(begins.velocities[None] - ends.velocities[:, None]).sum(axis=-1)
    change /= _SPEED_SD_MPS**2 + (_MEAN_ACCELERATION_MPS2 * hidden_s) ** 2
    best = np.full(hidden_s.shape, np.inf)
    for possible, off, spread_m, faster in (
        (stands, moved, np.full_like(hidden_s, _CREEP_M), 0.0),
        (
            hidden_s <= _LONGEST_MOVING_S,
            moved - mean_velocity * hidden_s[..., None],
            0.5 * _ACCELERATION_MPS2 * hidden_s**2,
            change,
        ),
    ):
        own = variance + spread_m**2
        squared = np.square(off).sum(axis=-1) / own + faster
        possible = possible & (hidden_s > 0) & ~far & (squared <= _GATE_SD**2)
        # near beginnings that are equally likely: the more certain one wins, as in the Gaussian likelihood
        cost = squared + 2 * np.log(own) + _COST_PER_S * hidden_s
        best = np.where(possible, np.minimum(best, cost), best)
    return best
