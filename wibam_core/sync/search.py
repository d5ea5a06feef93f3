"""Under which offsets two clocks tell of the same events, whatever these are.

Events are light changes or road users that pass. Two recordings may have been started hours apart, their clocks may
differ by half a per cent, and what they show repeats itself: traffic lights do by their cycle. So every offset at which
recordings could overlap is tried, with every drift, and an offset is judged by the *share* of events that could meet
another one and do. What the share tells depends on the pattern: where other offsets reach nearly the same share, the
pattern repeats itself, and none of them is believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Largest drift that is looked for: recordings of 29.97 frames per second that claim 30 drift by 0.1 %.
MAX_DRIFT = 5e-3
#: Standard deviation of the drift where little is known of it.
_DRIFT_SD = 5e-4
#: An offset is excluded where it is this much less likely than the best one, as a logarithm: 1 in 3,000. Much, since
#: the changes of one signal hang together and tell less than as many independent ones.
DECISIVE = 8.0
#: Offsets that are looked at closely.
_KEPT = 60
#: Offsets that are tried, of which some lead nowhere.
_TRIED = 4 * _KEPT
#: Shares are never taken for nearer to 0 or 1 than this.
_DOUBT = 0.02
#: Events that meet for free, as offset and drift are chosen so.
_FREE = 2.0
#: An offset tells how the pattern repeats itself if so large a part of the best one's events could meet under it.
_SUBSTANTIAL = 0.4


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of one event of each of two clocks that could be the same event.

    Attributes:
        first, second: (P,) indices of the two events.
        first_s, second_s: (P,) when they were, each on its own clock.
        tolerance_s: (P,) by how much the two may differ and still be the same.
    """

    first: IntArray
    second: IntArray
    first_s: Array
    second_s: Array
    tolerance_s: Array

    def __len__(self) -> int:
        return len(self.first)


@dataclass(frozen=True, eq=False)
class Watched:
    """Events of one clock that the other side could have seen, and when that was looking.

    Attributes:
        times_s: (N,) of the events, on their clock.
        spans_s: (S, 2) disjoint stretches, on the other clock, in which the other side would have seen them.
    """

    times_s: Array
    spans_s: Array


@dataclass(frozen=True, eq=False)
class Candidate:
    """A clock under which events meet: ``first = second + offset_s + drift * second``.

    Attributes:
        offset_s, drift: of the clock.
        pairs: rows of `Pairs` that meet, each event in one of them at most.
        could: how many events could meet, mean of both sides.
        evidence: logarithm of how much less likely as many would meet by chance.
    """

    offset_s: float
    drift: float
    pairs: IntArray
    could: float
    evidence: float

    @property
    def matched(self) -> int:
        return len(self.pairs)

    @property
    def share(self) -> float:
        """Of the events that could meet, how many do."""
        return min(self.matched / max(self.could, 1.0), 1.0)


def search(pairs: Pairs, first: Sequence[Watched], second: Sequence[Watched]) -> list[Candidate]:
    """Offsets and drifts under which events meet, the most telling first.

    Args:
        pairs: which events could be the same.
        first: events of the first clock, by when the second side was looking.
        second: events of the second clock, by when the first side was looking.
    """
    if not len(pairs):
        return []
    centre_s = float(np.median(pairs.second_s))
    differences = pairs.first_s - pairs.second_s
    tolerance_s = float(np.median(pairs.tolerance_s))
    low, width = float(differences.min()), tolerance_s / 2
    reach_s = max(float(np.ptp(pairs.second_s)), 1.0)
    steps = int(np.ceil(MAX_DRIFT * reach_s / 4 / tolerance_s))
    chance = _chance(pairs, first, second, tolerance_s)
    rough: list[tuple[float, float, float]] = []
    for drift in np.arange(-steps, steps + 1) * (MAX_DRIFT / max(steps, 1)):
        shifted = differences - drift * (pairs.second_s - centre_s)
        low = float(shifted.min()) - 2 * width
        counts = np.bincount(((shifted - low) / width).astype(np.int64) + 2).astype(np.float64)
        counts = np.convolve(counts, np.ones(4), "same")
        peaks = np.flatnonzero((counts > 0) & (counts >= np.maximum(np.roll(counts, 1), np.roll(counts, -1))))
        at_s = low + (peaks - 2) * width
        could = _could(first, second, at_s - drift * centre_s, np.full(len(peaks), drift))
        score = _evidence(np.minimum(counts[peaks], could), could, chance) - 0.5 * (drift / _DRIFT_SD / 4) ** 2
        best = np.argsort(-score, kind="stable")[:_TRIED]
        rough += zip(score[best].tolist(), at_s[best].tolist(), [float(drift)] * len(best), strict=True)
    rough.sort(key=lambda one: (-one[0], abs(one[1]), abs(one[2])))
    return _refined_all(pairs, first, second, rough, centre_s, 4 * tolerance_s, chance)


def unlikelihood(best: Candidate, other: Candidate, among: Sequence[Candidate]) -> float:
    """Logarithm of how much less likely ``other`` is than ``best``, given all that there are.

    Were ``other`` true, then what meets under ``best`` would do so by the pattern's repeating itself, which the other
    offsets show how far it does; and no more would be missed under ``other`` than is under ``best``. Any two pairs meet
    under some offset and drift: of each candidate, two events tell nothing.
    """
    rivals = [c for c in among if c is not best and c.could >= _SUBSTANTIAL * best.could]
    repeats = max(((c.matched - _FREE) / _telling(c) for c in rivals), default=0.0)
    by_chance = _telling(best) * _divergence(best.share, repeats) if best.share > repeats else 0.0
    shortfall = _telling(other) * _divergence(other.share, best.share) if other.share < best.share else 0.0
    surprise = _telling(other) * _divergence(other.share, repeats) if other.share > repeats else 0.0
    return by_chance + shortfall - surprise


def one_to_one(first: IntArray, second: IntArray, residual: Array) -> IntArray:
    """Indices of pairs (P,) such that each side is used once, the closest first, ascending."""
    taken_first: set[int] = set()
    taken_second: set[int] = set()
    kept = []
    for k in np.argsort(residual, kind="stable").tolist():
        if first[k] not in taken_first and second[k] not in taken_second:
            taken_first.add(int(first[k]))
            taken_second.add(int(second[k]))
            kept.append(k)
    return np.array(sorted(kept), dtype=np.int64)


def _refined_all(
    pairs: Pairs,
    first: Sequence[Watched],
    second: Sequence[Watched],
    rough: Sequence[tuple[float, float, float]],
    centre_s: float,
    apart_s: float,
    chance: float,
) -> list[Candidate]:
    places_s: list[float] = []
    found: list[Candidate] = []
    tried = 0
    for _, at_s, drift in rough:
        if any(abs(at_s - other) < apart_s for other in places_s):
            continue
        tried += 1
        candidate = _refined(pairs, first, second, at_s, drift, centre_s, chance)
        # one that leads nowhere keeps no neighbour out: events that are known exactly are met from near by alone
        if candidate is not None:
            found.append(candidate)
            places_s.append(candidate.offset_s + candidate.drift * centre_s)
        if len(found) == _KEPT or tried == _TRIED:
            break
    found.sort(key=lambda c: (-c.evidence, abs(c.offset_s)))
    distinct: list[Candidate] = []
    for candidate in found:
        if all(len(np.intersect1d(candidate.pairs, c.pairs)) < 0.5 * candidate.matched for c in distinct):
            distinct.append(candidate)
    return distinct


def _refined(
    pairs: Pairs,
    first: Sequence[Watched],
    second: Sequence[Watched],
    at_s: float,
    drift: float,
    centre_s: float,
    chance: float,
) -> Candidate | None:
    """The clock through the pairs that meet near a rough one, and these pairs."""
    since = pairs.second_s - centre_s
    met = np.empty(0, np.int64)
    for slack in (2.5, 2.0, 1.5, 1.0, 1.0):
        residual = pairs.first_s - pairs.second_s - at_s - drift * since
        near = np.flatnonzero(np.abs(residual) <= slack * pairs.tolerance_s)
        if not len(near):
            return None
        met = near[one_to_one(pairs.first[near], pairs.second[near], np.abs(residual[near]))]
        sigma = pairs.tolerance_s[met] / 2
        rows = np.stack([np.ones(len(met)), since[met]], axis=1) / sigma[:, None]
        left = (pairs.first_s - pairs.second_s)[met] / sigma
        rows = np.concatenate([rows, [[0.0, 1.0 / _DRIFT_SD]]])
        at_s, drift = np.linalg.lstsq(rows, np.append(left, 0.0), rcond=None)[0].tolist()
    if abs(drift) > MAX_DRIFT:
        return None
    offset_s = at_s - drift * centre_s
    could = max(float(_could(first, second, np.array([offset_s]), np.array([drift]))[0]), float(len(met)))
    evidence = float(_evidence(np.array([len(met)]), np.array([could]), chance)[0])
    return Candidate(offset_s, drift, met, could, evidence)


def _could(first: Sequence[Watched], second: Sequence[Watched], offset_s: Array, drift: Array) -> Array:
    """How many events could meet under each clock (C,), mean of both sides."""
    total = np.zeros(len(offset_s))
    for watched in first:
        times = np.sort(watched.times_s)
        for begin, end in watched.spans_s:
            total += np.searchsorted(times, offset_s + (1 + drift) * end, side="right")
            total -= np.searchsorted(times, offset_s + (1 + drift) * begin, side="left")
    for watched in second:
        times = np.sort(watched.times_s)
        for begin, end in watched.spans_s:
            total += np.searchsorted(times, (end - offset_s) / (1 + drift), side="right")
            total -= np.searchsorted(times, (begin - offset_s) / (1 + drift), side="left")
    return total / 2


def _chance(pairs: Pairs, first: Sequence[Watched], second: Sequence[Watched], tolerance_s: float) -> float:
    """Share of events that meet under any offset."""
    differences = pairs.first_s - pairs.second_s
    grid = np.linspace(differences.min(), differences.max(), 200)
    could = float(_could(first, second, grid, np.zeros(len(grid))).mean())
    met = len(pairs) * 2 * tolerance_s / max(float(np.ptp(differences)), 2 * tolerance_s)
    return float(np.clip(met / max(could, 1.0), 0.01, 0.5))


def _evidence(matched: Array, could: Array, chance: float) -> Array:
    share = np.minimum(matched / np.maximum(could, 1.0), 1.0)
    p = np.clip(share, _DOUBT, 1 - _DOUBT)
    log = p * np.log(p / chance) + (1 - p) * np.log((1 - p) / (1 - chance))
    return np.where(share > chance, np.maximum(could, 1.0) * log, 0.0)


def _telling(candidate: Candidate) -> float:
    return max(candidate.could - _FREE, 1.0)


def _divergence(share: float, other: float) -> float:
    """Kullback-Leibler divergence of two shares: how surprising, an event, ``share`` is where ``other`` is usual."""
    p, q = (min(max(value, _DOUBT), 1 - _DOUBT) for value in (share, other))
    return float(p * np.log(p / q) + (1 - p) * np.log((1 - p) / (1 - q)))
