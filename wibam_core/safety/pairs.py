"""Which pairs of tracks may be in conflict, and when: cheap tests with room for error, before the exact measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from wibam_core.config import SafetyConfig
from wibam_core.geometry.box3d import LENGTH, WIDTH, XY, YAW
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.progress import Progress
from wibam_core.safety.track_errors import TrackErrors
from wibam_core.safety.ttc import time_to_collision
from wibam_core.scene import Track

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: How far beyond what the tracks say two may come to each other, in standard deviations of both, and at least, m.
_MARGIN_SD, _MARGIN_M = 2.5, 0.5
#: Speeds err by about this much, m/s: nobody is left out by less.
_SPEED_MARGIN_MPS = 1.0
#: A pair's errors are as good as new about so often while the two approach each other; no probability below this is
#: looked for.
_MOMENTS, _LEAST_PROBABILITY = 10, 0.001
#: Paths are compared on cells of this size, m.
_CELL_M = 4.0


@dataclass(frozen=True, eq=False)
class PairInstants:
    """Common instants of two tracks.

    Attributes:
        index_a, index_b: (K,) indices into the two tracks, in time order.
        consecutive: (K,) whether no instant of either track lies between this one and the one before.
    """

    index_a: Indices
    index_b: Indices
    consecutive: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _All:
    """States (N) of all tracks, sorted by time, those of one instant by track."""

    times_ns: Indices
    track: Indices
    place: Array
    velocity: Array
    boxes: Array
    reach: Array
    margin: Array
    place_sd: Array
    size_sd: Array

    @classmethod
    def of(cls, tracks: Sequence[Track]) -> _All:
        times = np.concatenate([t.times_ns for t in tracks])
        track = np.repeat(np.arange(len(tracks)), [len(t) for t in tracks])
        order = np.lexsort((track, times))
        boxes = np.concatenate([t.boxes for t in tracks])[order]
        sd = np.nan_to_num(np.concatenate([t.sd for t in tracks])[order])
        place_sd = sd[:, XY].max(axis=1)
        return cls(
            times[order],
            track[order],
            boxes[:, XY],
            np.concatenate([t.velocities_mps for t in tracks])[order],
            boxes,
            0.5 * np.hypot(boxes[:, LENGTH], boxes[:, WIDTH]),
            _MARGIN_M + _MARGIN_SD * place_sd,
            place_sd,
            np.hypot(0.5 * sd[:, LENGTH], 0.5 * boxes[:, LENGTH] * sd[:, YAW]),
        )

    @property
    def yaw(self) -> Array:
        return self.boxes[:, YAW]


def approaching(
    tracks: Sequence[Track], config: SafetyConfig, errors: TrackErrors, progress: Progress
) -> dict[tuple[int, int], Indices]:
    """Pairs of tracks, as places in the sequence (smaller first), with the times (ns) at which they may be on a crash
    course: straight on they would come within reach in less than ``config.ttc_s``, and it would take braking to avoid
    it. Pairs that would need larger errors for that than such tracks have are left out: less probable than
    ``config.min_probability``.
    """
    horizon_s, min_deceleration_mps2 = config.ttc_s, config.min_deceleration_mps2
    if not tracks:
        return {}
    every = _All.of(tracks)
    starts = np.flatnonzero(np.r_[True, np.diff(every.times_ns) > 0])
    ends = np.r_[starts[1:], len(every.times_ns)]
    triangles: dict[int, tuple[Indices, Indices]] = {}
    found: list[Indices] = []
    for done, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        n = end - start
        if n < 2:
            continue
        if n not in triangles:
            triangles[n] = np.triu_indices(n, 1)
        i, j = triangles[n]
        i, j = i + start, j + start
        offset = every.place[j] - every.place[i]
        velocity = every.velocity[j] - every.velocity[i]
        closing2 = _dot(velocity, velocity)
        approach = -_dot(offset, velocity)
        distance2 = _dot(offset, offset)
        reach = every.reach[i] + every.reach[j] + every.margin[i] + every.margin[j]
        speed = np.sqrt(closing2) + _SPEED_MARGIN_MPS
        gap = np.sqrt(distance2) - reach
        may = gap < speed * horizon_s
        if min_deceleration_mps2 > 0:
            may &= gap < speed**2 / (2 * min_deceleration_mps2)
        # the least distance straight on, with more room the farther that is: courses err, too
        time = np.clip(approach / np.maximum(closing2, 1e-9), 0.0, horizon_s)
        nearest2 = distance2 - 2 * time * approach + time**2 * closing2
        may &= (nearest2 < (reach + _SPEED_MARGIN_MPS * time) ** 2) & ((approach > 0) | (gap < 0))
        rows = np.flatnonzero(may)
        if len(rows):
            found.append(np.stack([i[rows], j[rows]]))
        if done % 500 == 0:
            progress(0.3 * done / len(starts), "Looking for crash courses")
    if not found:
        return {}
    one, other = np.concatenate(found, axis=1)
    return _by_pair(every, one, other, _may_be_critical(every, one, other, config, errors))


def _dot(one: Array, other: Array) -> Array:
    """Inner products (N,) of vectors (N, 2)."""
    return one[:, 0] * other[:, 0] + one[:, 1] * other[:, 1]


def _may_be_critical(
    every: _All, i: Indices, j: Indices, config: SafetyConfig, errors: TrackErrors
) -> NDArray[np.bool_]:
    """(R,) whether states i and j (R,) of two are critical if they err by as much as is still likely enough.

    The footprints are as much larger as place, course and size may err until the two are nearest. The likeliest of a
    pair's moments stands for about `_MOMENTS` that err on their own.
    """
    deviations = float(ndtri(1.0 - max(config.min_probability, _LEAST_PROBABILITY) / _MOMENTS))
    a, b = every.boxes[i].copy(), every.boxes[j].copy()
    velocity = every.velocity[j] - every.velocity[i]
    speed2 = (velocity**2).sum(axis=1)
    nearest_s = -((b[:, XY] - a[:, XY]) * velocity).sum(axis=1) / np.maximum(speed2, 1e-9)
    nearest_s = np.clip(nearest_s, 0.0, config.ttc_s)
    both = np.hypot(every.place_sd[i], every.place_sd[j])
    place_sd = max(errors.along, errors.across) * both
    speed_sd = max(errors.along / errors.along_s, errors.across / errors.across_s) * both
    size_sd = np.hypot(every.size_sd[i], every.size_sd[j]) * max(errors.size, errors.yaw)
    more_m = deviations * np.sqrt(place_sd**2 + (speed_sd * nearest_s) ** 2 + size_sd**2)
    for boxes in (a, b):
        boxes[:, LENGTH] += more_m
        boxes[:, WIDTH] += more_m
    ttc = time_to_collision(a, every.velocity[i], b, every.velocity[j])
    speed = np.sqrt(speed2)
    faster = speed + deviations * speed_sd
    # the way that is left, at the higher speed
    with np.errstate(invalid="ignore"):
        ttc = np.where(np.isfinite(ttc), ttc * speed / np.maximum(faster, 1e-9), np.inf)
    moves = np.maximum(np.hypot(*every.velocity[i].T), np.hypot(*every.velocity[j].T))
    may = (ttc < config.ttc_s) & (moves + deviations * speed_sd >= config.min_speed_mps)
    return np.asarray(may & (faster >= 2 * ttc * config.min_deceleration_mps2))


def _by_pair(every: _All, i: Indices, j: Indices, may: NDArray[np.bool_]) -> dict[tuple[int, int], Indices]:
    """The times of each pair of states i and j (R,), of pairs of tracks that may be critical at any of them."""
    a, b, times = every.track[i], every.track[j], every.times_ns[i]
    order = np.lexsort((times, b, a))
    a, b, times, may = a[order], b[order], times[order], may[order]
    starts = np.flatnonzero(np.r_[True, (np.diff(a) != 0) | (np.diff(b) != 0)])
    ends = np.r_[starts[1:], len(a)]
    any_may = np.logical_or.reduceat(may, starts)
    return {
        (int(a[s]), int(b[s])): times[s:e]
        for s, e in zip(starts[any_may].tolist(), ends[any_may].tolist(), strict=True)
    }


def crossing(
    tracks: Sequence[Track], within_s: float, min_heading_difference_rad: float, min_speed_mps: float
) -> set[tuple[int, int]]:
    """Pairs of tracks, as places in the sequence (smaller first), that moved through one cell of the ground on
    different courses, one not much later than ``within_s`` after the other."""
    if not tracks:
        return set()
    every = _All.of(tracks)
    moving = np.hypot(*every.velocity.T) >= 0.5 * min_speed_mps
    cells = np.floor(every.place[moving] / _CELL_M).astype(np.int64)
    track, time_s, yaw = every.track[moving], every.times_ns[moving] * 1e-9, every.yaw[moving]
    # a state counts for the cells around its own, too: footprints are larger than their middle
    around = np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])
    cell = (cells[:, None] + around).reshape(-1, 2)
    track, time_s, yaw = (np.repeat(values, len(around)) for values in (track, time_s, yaw))
    key = (cell[:, 0] + 2**20) * 2**21 + cell[:, 1] + 2**20
    order = np.lexsort((time_s, track, key))
    key, track, time_s, yaw = key[order], track[order], time_s[order], yaw[order]
    starts = np.flatnonzero(np.r_[True, (np.diff(key) != 0) | (np.diff(track) != 0)])
    ends = np.r_[starts[1:], len(key)]
    key, track, enters, leaves, yaw = (
        key[starts],
        track[starts],
        time_s[starts],
        time_s[ends - 1],
        yaw[(starts + ends) // 2],
    )
    order = np.lexsort((enters, key))
    key, track, enters, leaves, yaw = key[order], track[order], enters[order], leaves[order], yaw[order]
    latest = float((leaves - enters).max(initial=0.0)) + within_s
    pairs: set[tuple[int, int]] = set()
    for step in range(1, len(key)):
        same = (key[step:] == key[:-step]) & (enters[step:] - enters[:-step] <= latest)
        if not same.any():
            break
        near = same & (enters[step:] - leaves[:-step] <= within_s) & (track[step:] != track[:-step])
        near &= np.abs(normalise_angle(yaw[step:] - yaw[:-step])) >= 0.8 * min_heading_difference_rad
        rows = np.flatnonzero(near)
        one, other = track[rows], track[rows + step]
        pairs |= set(zip(np.minimum(one, other).tolist(), np.maximum(one, other).tolist(), strict=True))
    return pairs


def together(a: Track, b: Track, begin_ns: int, end_ns: int) -> PairInstants:
    """The instants from ``begin_ns`` to ``end_ns`` that both tracks have."""
    first_a, last_a = np.searchsorted(a.times_ns, [begin_ns, end_ns + 1]).tolist()
    first_b, last_b = np.searchsorted(b.times_ns, [begin_ns, end_ns + 1]).tolist()
    times_a, times_b = a.times_ns[first_a:last_a], b.times_ns[first_b:last_b]
    if not len(times_a) or not len(times_b):
        return PairInstants(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, bool))
    index_b = np.minimum(np.searchsorted(times_b, times_a), len(times_b) - 1)
    index_a = np.flatnonzero(times_b[index_b] == times_a)
    index_b = index_b[index_a]
    step = (np.diff(index_a) == 1) & (np.diff(index_b) == 1)
    return PairInstants(index_a + first_a, index_b + first_b, np.r_[False, step][: len(index_a)])
