"""Linking of positions over time: constant-velocity prediction, cheapest assignment, a gate by speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from wibam_core.scene import FloatArray, IntArray

_ACCELERATION_MPS2 = 3.0
_FIRST_SPEED_SD_MPS = 8.0
_GATE_SD = 3.5
_CLASS_CHANGE_COST = 2.0


@dataclass(frozen=True, eq=False)
class Sightings:
    """What is seen at one instant.

    Attributes:
        times_ns: (N,) when each position holds. positions: (N, 2), m. sd_m: (N,) of the positions.
        classes: (N,) class indices; a change of class makes a link less likely.
    """

    times_ns: IntArray
    positions: FloatArray
    sd_m: FloatArray
    classes: IntArray


def link(instants: Sequence[Sightings], max_speed_mps: float, max_gap_s: float = 1.0) -> list[IntArray]:
    """Give each sighting a track id.

    Args:
        instants: in order of time.
        max_speed_mps: no link needs a faster vehicle.
        max_gap_s: a track unseen for longer ends.

    Returns:
        For every instant (N,) ids 0, 1, ... by first appearance; −1 for what is never seen again.
    """
    active = _Tracks.empty()
    links: list[IntArray] = []
    next_id = 0
    for seen in instants:
        if len(seen.times_ns):
            active = active.alive(int(seen.times_ns.min()), max_gap_s)
        ids = np.full(len(seen.times_ns), -1, dtype=np.int64)
        rows, columns = _match(active, seen, max_speed_mps)
        ids[columns] = active.ids[rows]
        active.update(rows, seen, columns)
        fresh = np.flatnonzero(ids < 0)
        ids[fresh] = next_id + np.arange(len(fresh))
        next_id += len(fresh)
        active = active.joined(_Tracks.starting(ids[fresh], seen, fresh))
        links.append(ids)
    return _renumber(links, next_id)


def _renumber(links: list[IntArray], count: int) -> list[IntArray]:
    if not links:
        return links
    sightings = np.bincount(np.concatenate(links), minlength=count)
    kept = sightings > 1
    names = np.where(kept, np.cumsum(kept) - 1, -1)
    return [names[ids] for ids in links]


@dataclass(eq=False)
class _Tracks:
    """Kalman states of T tracks: position and velocity per axis, with one covariance for both axes."""

    ids: IntArray  # (T,)
    times_ns: IntArray  # (T,)
    state: FloatArray  # (T, 2, 2): [position, velocity] x [x, y]
    covariance: FloatArray  # (T, 2, 2) of [position, velocity]
    classes: IntArray  # (T,)

    @classmethod
    def empty(cls) -> _Tracks:
        none = np.empty(0, dtype=np.int64)
        return cls(none, none, np.empty((0, 2, 2)), np.empty((0, 2, 2)), none)

    @classmethod
    def starting(cls, ids: IntArray, seen: Sightings, which: IntArray) -> _Tracks:
        state = np.zeros((len(which), 2, 2))
        state[:, 0] = seen.positions[which]
        covariance = np.zeros((len(which), 2, 2))
        covariance[:, 0, 0] = seen.sd_m[which] ** 2
        covariance[:, 1, 1] = _FIRST_SPEED_SD_MPS**2
        return cls(ids, seen.times_ns[which], state, covariance, seen.classes[which])

    def alive(self, now_ns: int, max_gap_s: float) -> _Tracks:
        keep = _seconds(now_ns - self.times_ns) <= max_gap_s
        return _Tracks(self.ids[keep], self.times_ns[keep], self.state[keep], self.covariance[keep], self.classes[keep])

    def joined(self, other: _Tracks) -> _Tracks:
        return _Tracks(
            np.concatenate([self.ids, other.ids]),
            np.concatenate([self.times_ns, other.times_ns]),
            np.concatenate([self.state, other.state]),
            np.concatenate([self.covariance, other.covariance]),
            np.concatenate([self.classes, other.classes]),
        )

    def update(self, rows: IntArray, seen: Sightings, columns: IntArray) -> None:
        """Kalman prediction to, and correction by, the matched sightings."""
        dt = _seconds(seen.times_ns[columns] - self.times_ns[rows])
        step = np.tile(np.eye(2), (len(rows), 1, 1))
        step[:, 0, 1] = dt
        state = step @ self.state[rows]
        covariance = step @ self.covariance[rows] @ step.transpose(0, 2, 1) + _process_noise(dt)
        gain = covariance[:, :, 0] / (covariance[:, 0, 0] + seen.sd_m[columns] ** 2)[:, None]
        innovation = seen.positions[columns] - state[:, 0]
        self.state[rows] = state + gain[:, :, None] * innovation[:, None, :]
        self.covariance[rows] = covariance - gain[:, :, None] * covariance[:, None, 0, :]
        self.times_ns[rows] = seen.times_ns[columns]
        self.classes[rows] = seen.classes[columns]


def _seconds(interval_ns: IntArray) -> FloatArray:
    return np.asarray(interval_ns * 1e-9, dtype=np.float64)


def _process_noise(dt: FloatArray) -> FloatArray:
    """(..., 2, 2) of a constant velocity disturbed by white acceleration over ``dt`` (...) s."""
    q = _ACCELERATION_MPS2**2
    rows = [[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]]
    return np.asarray(q * np.stack([np.stack(row, axis=-1) for row in rows], axis=-2))


def _match(tracks: _Tracks, seen: Sightings, max_speed_mps: float) -> tuple[IntArray, IntArray]:
    """Matched track rows and sighting columns."""
    if len(tracks.ids) == 0 or len(seen.times_ns) == 0:
        none = np.empty(0, dtype=np.int64)
        return none, none
    dt = _seconds(seen.times_ns[None] - tracks.times_ns[:, None])
    position, velocity = tracks.state[:, None, 0], tracks.state[:, None, 1]
    predicted = position + velocity * dt[..., None]
    c = tracks.covariance[:, None]
    variance = c[..., 0, 0] + 2 * dt * c[..., 0, 1] + dt**2 * c[..., 1, 1] + _process_noise(dt)[..., 0, 0]
    variance = variance + seen.sd_m[None] ** 2
    squared = np.square(seen.positions[None] - predicted).sum(axis=-1) / variance
    moved = np.linalg.norm(seen.positions[None] - position, axis=-1)
    reachable = max_speed_mps * np.abs(dt) + _GATE_SD * np.sqrt(seen.sd_m[None] ** 2 + c[..., 0, 0])
    allowed = (squared <= _GATE_SD**2) & (moved <= reachable)
    # near tracks that are equally likely: the more certain one wins, as in the Gaussian likelihood
    cost = squared + 2 * np.log(variance) + _CLASS_CHANGE_COST * (seen.classes[None] != tracks.classes[:, None])
    refused = 1e6
    rows, columns = linear_sum_assignment(np.where(allowed, cost, refused))
    good = allowed[rows, columns]
    return rows[good].astype(np.int64), columns[good].astype(np.int64)
