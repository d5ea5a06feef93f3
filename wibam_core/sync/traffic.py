"""Two cameras' clocks from the road users that both see, without a light and without knowing who is who.

A road user seen by both cameras at one place says by how much their clocks differ. Who is who is found as light changes
are matched (`wibam_core.sync.search`): each way that one camera sees is compared with every way of the other that leads
over the same ground in the same direction, and under the true offset far more of them meet than under any other.

Ground points are wrong by decimetres: each camera sees another side of a vehicle, and calibrations disagree. For a
vehicle at 8 m/s, 0.4 m are 50 ms. But such an error depends on the place and on the axis along which the vehicle
stands, and not on which way it drives, or how fast; what a clock is wrong by, multiplied by the velocity, does. So both
are solved at once, with an error of each road user's own on top.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wibam_core.sync.biases import Samples, joined, solve
from wibam_core.sync.offsets import Meeting
from wibam_core.sync.paths import GroundPath
from wibam_core.sync.search import DECISIVE, Candidate, Pairs, Watched, one_to_one, search, unlikelihood

Array = NDArray[np.float64]

#: Ways are compared at places so far apart, where the road user moves at least so fast.
_SPACING_M = 2.0
_LEAST_SPEED_MPS = 2.0
#: At one place are points that lie no farther apart than this, and across the direction of travel half of it.
_NEAR_M = 3.0
#: Two ways belong to one road user if they meet at so many places, with times that differ by one and the same offset.
_LEAST_PLACES = 3
_STEADY_S = 0.35
#: By how much the times of one road user in two cameras may differ once the clocks are known.
_TOLERANCE_S = 0.3
#: The lights and the traffic mean one offset if they differ by less than this.
_EXPECTED_S = 1.0
#: Fewer road users than this prove nothing.
_LEAST_MET = 5
#: How often the clocks are corrected; before the last two times, who is who is asked again.
_TURNS = 4
#: A road user that both see lies no farther from itself than this, for at least so many samples.
_SAME_M = 2.5
_LEAST_SAMPLES = 3
#: No moment is known better than this: frames are exposed for some time, and row by row, s.
_FLOOR_S = 0.003


@dataclass(frozen=True, eq=False)
class TrafficAlignment:
    """What the road users say of two cameras' clocks.

    Attributes:
        first_id, second_id: the cameras; ``first = second + offset_s + drift * second``.
        taken: the likeliest candidate.
        rivals: others that explain as much, likeliest first; empty where the answer is clear.
        worse: others.
        meeting: the refined answer; None where too few road users meet.
    """

    first_id: str
    second_id: str
    taken: Candidate
    rivals: tuple[Candidate, ...]
    worse: tuple[Candidate, ...]
    meeting: Meeting | None

    @property
    def is_clear(self) -> bool:
        return self.meeting is not None and not self.rivals


def align_by_traffic(
    first_id: str,
    first: Sequence[GroundPath],
    first_span_s: tuple[float, float],
    second_id: str,
    second: Sequence[GroundPath],
    second_span_s: tuple[float, float],
    expected: Sequence[float] = (),
) -> TrafficAlignment | None:
    """Offset and drift of two cameras, from the ways of road users; None where none could be one and the same.

    Args:
        first_id: one camera.
        first: the ways that it sees, on its own clock.
        first_span_s: first and last time of its recording, on its own clock.
        second_id: the other camera.
        second: what that sees.
        second_span_s: first and last time of that.
        expected: offsets (s) that the lights leave open: the traffic decides between them where it cannot alone.
    """
    pairs = _possible(first, second)
    if not len(pairs):
        return None
    found = search(
        pairs,
        [Watched(_times(first)[np.unique(pairs.first)], np.array([second_span_s]))],
        [Watched(_times(second)[np.unique(pairs.second)], np.array([first_span_s]))],
    )
    found = [c for c in found if c.matched >= _LEAST_MET]
    if not found:
        return None
    best = found[0]
    rivals = tuple(c for c in found[1:] if unlikelihood(best, c, found) < DECISIVE)
    likely = [c for c in (best, *rivals) if any(abs(c.offset_s - offset_s) < _EXPECTED_S for offset_s in expected)]
    if rivals and likely:
        best = likely[0]
        rivals = tuple(c for c in likely[1:] if unlikelihood(best, c, likely) < DECISIVE)
    worse = tuple(c for c in found if c is not best and c not in rivals)
    meeting = refine(
        first_id, first, second_id, second, [(int(pairs.first[k]), int(pairs.second[k])) for k in best.pairs], best
    )
    return TrafficAlignment(first_id, second_id, best, rivals, worse, meeting)


def refine(
    first_id: str,
    first: Sequence[GroundPath],
    second_id: str,
    second: Sequence[GroundPath],
    met: Sequence[tuple[int, int]],
    rough: Candidate,
) -> Meeting | None:
    """The clocks from road users that are known to be the same, to a few milliseconds.

    Args:
        first_id: one camera.
        first: the ways that it sees.
        second_id: the other camera.
        second: what that sees.
        met: indices of ways of one road user.
        rough: the clocks, to a few tenths of a second.
    """
    offset_s, drift = rough.offset_s, rough.drift
    solved: tuple[Array, Array] | None = None
    centre_s = 0.0
    for turn in range(_TURNS):
        if turn == _TURNS - 2:
            met = _met(first, second, offset_s, drift) or met
        samples = _compared(first, second, met, offset_s, drift)
        if len(np.unique(samples.road_user)) < _LEAST_MET:
            return None
        weight = (samples.velocity_mps**2).sum(axis=1)
        centre_s = float((weight * samples.second_s).sum() / weight.sum())
        solved = solve(samples, centre_s, drift)
        shift, rate = solved[0].tolist()
        offset_s, drift = offset_s + shift - rate * centre_s, drift + rate
    assert solved is not None
    covariance = solved[1]
    # The moment at which the errors of offset and drift are independent.
    centre_s -= covariance[0, 1] / covariance[1, 1]
    sd_s = float(np.sqrt(max(covariance[0, 0] - covariance[0, 1] ** 2 / covariance[1, 1], 0.0) + _FLOOR_S**2))
    first_s = centre_s + offset_s + drift * centre_s
    return Meeting(first_id, second_id, first_s, centre_s, drift, sd_s, float(np.sqrt(covariance[1, 1])))


def _times(paths: Sequence[GroundPath]) -> Array:
    return np.array([path.times_s.mean() for path in paths])


@dataclass(frozen=True, eq=False)
class _Places:
    """Samples (N,) of many ways at places some metres apart, where the road users move."""

    path: NDArray[np.int64]
    time_s: Array
    point_m: Array
    velocity_mps: Array

    @classmethod
    def of(cls, paths: Sequence[GroundPath]) -> _Places:
        chosen = []
        for path in paths:
            moving = np.linalg.norm(path.velocities_mps, axis=1) >= _LEAST_SPEED_MPS
            gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.points_m, axis=0), axis=1))])
            _, at = np.unique(np.floor(gone / _SPACING_M), return_index=True)
            chosen.append(at[moving[at]])
        return cls(
            np.repeat(np.arange(len(paths)), [len(at) for at in chosen]),
            np.concatenate([p.times_s[at] for p, at in zip(paths, chosen, strict=True)] or [np.empty(0)]),
            np.concatenate([p.points_m[at] for p, at in zip(paths, chosen, strict=True)] or [np.empty((0, 2))]),
            np.concatenate([p.velocities_mps[at] for p, at in zip(paths, chosen, strict=True)] or [np.empty((0, 2))]),
        )


def _possible(first: Sequence[GroundPath], second: Sequence[GroundPath]) -> Pairs:
    """Pairs of ways that lead over the same ground in the same direction, and when each was there."""
    a, b = _Places.of(first), _Places.of(second)
    empty = np.empty(0, np.int64)
    if not len(a.path) or not len(b.path):
        return Pairs(empty, empty, np.empty(0), np.empty(0), np.empty(0))
    near = cKDTree(a.point_m).sparse_distance_matrix(cKDTree(b.point_m), _NEAR_M, output_type="ndarray")
    i, j = near["i"], near["j"]
    va, vb = a.velocity_mps[i], b.velocity_mps[j]
    speed_a, speed_b = np.linalg.norm(va, axis=1), np.linalg.norm(vb, axis=1)
    mean = 0.5 * (va + vb)
    speed = np.maximum(np.linalg.norm(mean, axis=1), 0.1)
    along = mean / speed[:, None]
    apart = a.point_m[i] - b.point_m[j]
    across = np.abs(apart[:, 0] * along[:, 1] - apart[:, 1] * along[:, 0])
    same = (va * vb).sum(axis=1) > 0.85 * speed_a * speed_b
    same &= (np.abs(speed_a - speed_b) < 0.4 * speed + 1.0) & (across < _NEAR_M / 2)
    i, j, along, apart, speed = i[same], j[same], along[same], apart[same], speed[same]
    difference = a.time_s[i] - b.time_s[j] - (apart * along).sum(axis=1) / speed
    key = a.path[i] * len(second) + b.path[j]
    order = np.argsort(key, kind="stable")
    key, difference = key[order], difference[order]
    at_b = b.time_s[j][order]
    bounds = np.flatnonzero(np.diff(key, prepend=-1))
    rows = []
    for begin, end in pairwise([*bounds.tolist(), len(key)]):
        if end - begin < _LEAST_PLACES:
            continue
        middle = float(np.median(difference[begin:end]))
        if np.median(np.abs(difference[begin:end] - middle)) < _STEADY_S:
            second_s = float(np.mean(at_b[begin:end]))
            rows.append((key[begin] // len(second), key[begin] % len(second), second_s + middle, second_s))
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return Pairs(
        table[:, 0].astype(np.int64),
        table[:, 1].astype(np.int64),
        table[:, 2],
        table[:, 3],
        np.full(len(table), _TOLERANCE_S),
    )


def _met(
    first: Sequence[GroundPath], second: Sequence[GroundPath], offset_s: float, drift: float
) -> list[tuple[int, int]]:
    """Ways of one road user, those that stand or creep included, once the clocks are known to a tenth of a second."""
    begins = np.array([offset_s + (1 + drift) * path.times_s[0] for path in second])
    ends = np.array([offset_s + (1 + drift) * path.times_s[-1] for path in second])
    rows = []
    for i, path in enumerate(first):
        for j in np.flatnonzero((begins < path.times_s[-1]) & (ends > path.times_s[0])).tolist():
            samples = _compared(first, second, [(i, j)], offset_s, drift)
            if len(samples) >= _LEAST_SAMPLES:
                rows.append((i, j, float(np.median(np.linalg.norm(samples.apart_m, axis=1)))))
    near = np.array([row for row in rows if row[2] < _SAME_M]).reshape(-1, 3)
    one, other = near[:, 0].astype(np.int64), near[:, 1].astype(np.int64)
    return [(int(one[k]), int(other[k])) for k in one_to_one(one, other, near[:, 2])]


def _compared(
    first: Sequence[GroundPath],
    second: Sequence[GroundPath],
    met: Sequence[tuple[int, int]],
    offset_s: float,
    drift: float,
) -> Samples:
    parts = []
    for number, (i, j) in enumerate(met):
        one, other = first[i], second[j]
        at_s = (one.times_s - offset_s) / (1 + drift)
        inside = (at_s >= other.times_s[0]) & (at_s <= other.times_s[-1])
        gap = np.diff(other.times_s)
        step = np.clip(np.searchsorted(other.times_s, at_s) - 1, 0, len(gap) - 1)
        inside &= gap[step] < 1.0
        if inside.sum() < 2:
            continue
        at_s = at_s[inside]
        theirs = _hermite(other, at_s)
        speeds = np.column_stack([np.interp(at_s, other.times_s, other.velocities_mps[:, k]) for k in (0, 1)])
        parts.append(
            Samples(
                np.full(len(at_s), number),
                at_s,
                0.5 * (one.points_m[inside] + theirs),
                0.5 * (one.velocities_mps[inside] + speeds),
                one.points_m[inside] - theirs,
                np.hypot(one.sd_m[inside], np.interp(at_s, other.times_s, other.sd_m)),
            )
        )
    return joined(parts)


def _hermite(path: GroundPath, at_s: Array) -> Array:
    """(N, 2) places of a way at times within it, by cubics through places and velocities."""
    k = np.clip(np.searchsorted(path.times_s, at_s, side="right") - 1, 0, len(path) - 2)
    step = (path.times_s[k + 1] - path.times_s[k])[:, None]
    u = (at_s[:, None] - path.times_s[k][:, None]) / step
    p, v = path.points_m, path.velocities_mps
    return np.asarray(
        (1 + 2 * u) * (1 - u) ** 2 * p[k]
        + u * (1 - u) ** 2 * step * v[k]
        + u**2 * (3 - 2 * u) * p[k + 1]
        + u**2 * (u - 1) * step * v[k + 1]
    )
