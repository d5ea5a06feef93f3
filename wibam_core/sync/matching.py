"""Which changes of several cameras are one and the same, before any clock is known.

Cameras join one by one, the one that shares most with those already joined first. Each is put where the largest share
of the changes that could meet one of the same signal and the same transition does (`wibam_core.sync.search`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wibam_core.clocks import SignalChange
from wibam_core.errors import NoSignalChange
from wibam_core.sync.search import DECISIVE, Candidate, Pairs, Watched, one_to_one, search, unlikelihood

Array = NDArray[np.float64]

#: Lamps need some time to light up, and rows of a frame are exposed one after another.
_SLACK_S = 0.02
#: An offset found otherwise decides for one that is as near as this.
_DECIDED_S = 1.0
#: Other offsets that are told, beside all that explain the changes as well as the one that is taken.
_WORSE_TOLD = 4


@dataclass
class ChangeGroup:
    """One change of a signal, as seen by one or more cameras.

    Attributes:
        signal_id, before, after: what changed.
        time_s: roughly when, on the reference camera's clock.
        seen: camera id -> that camera's observation.
    """

    signal_id: str
    before: str
    after: str
    time_s: float
    seen: dict[str, SignalChange] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str, str]:
        return self.signal_id, self.before, self.after


@dataclass(frozen=True)
class Offset:
    """A clock of a camera against the reference, and how well light changes meet under it.

    Attributes:
        offset_s, drift: ``t_ref = t + offset_s + drift * t``, before refinement.
        matched: changes that meet another camera's.
        could: changes that could meet another camera's, mean of both sides.
        excluded: whether it explains the changes far worse than the one that was taken.
    """

    offset_s: float
    drift: float
    matched: int
    could: float
    excluded: bool = False

    @property
    def share(self) -> float:
        """Of the changes that could meet, how many do."""
        return min(self.matched / max(self.could, 1.0), 1.0)


@dataclass(frozen=True)
class Alignment:
    """How one camera's changes meet those of the others.

    Attributes:
        taken: the clock that is believed.
        alternatives: others under which a good share meets, best first.
        decided: whether another witness has chosen among those that do as well.
    """

    taken: Offset
    alternatives: tuple[Offset, ...] = ()
    decided: bool = False

    @property
    def is_ambiguous(self) -> bool:
        """Whether another offset explains the changes as well, and nothing else decides."""
        return not self.decided and any(not other.excluded for other in self.alternatives)

    @property
    def open_s(self) -> list[float]:
        """All offsets that the light changes leave open, s."""
        return [self.taken.offset_s, *(other.offset_s for other in self.alternatives if not other.excluded)]


def match_changes(
    changes: Mapping[str, Sequence[SignalChange]],
    reference_id: str,
    max_offset_s: float | None = None,
    spans_s: Mapping[str, tuple[float, float]] | None = None,
    near_s: Mapping[str, float] | None = None,
    *,
    partial: bool = False,
    owners: Mapping[str, str] | None = None,
) -> tuple[list[ChangeGroup], dict[str, Alignment]]:
    """Group the changes of all cameras.

    Args:
        changes: camera id -> its changes; every camera of the site.
        reference_id: the camera whose clock is kept.
        max_offset_s: of offsets that explain the changes equally well, smaller ones than this are preferred.
        spans_s: camera id -> first and last time of its recording, on its own clock; those of its changes if absent.
        near_s: camera id -> an offset found otherwise, which decides between equally good ones.
        partial: leave out cameras that share no change with the others.
        owners: id -> camera, where several are segments of one camera, which never see the same change.

    Returns:
        groups seen by at least two cameras, by time, and the alignment of every camera but the reference.

    Raises:
        NoSignalChange: naming a camera that saw no change, or none that another camera saw.
    """
    for camera_id, seen in changes.items():
        if not seen:
            raise NoSignalChange(f"no signal change was seen in camera {camera_id}", camera=camera_id)
    spans = {camera_id: _span(seen, (spans_s or {}).get(camera_id)) for camera_id, seen in changes.items()}
    groups = [
        ChangeGroup(c.signal_id, c.before, c.after, c.time_ns / 1e9, {reference_id: c}) for c in changes[reference_id]
    ]
    joined = {reference_id: spans[reference_id]}
    alignments: dict[str, Alignment] = {}
    waiting = [camera_id for camera_id in changes if camera_id != reference_id]
    while waiting:
        found = {
            c: align(
                _of_others(groups, c, owners),
                changes[c],
                {other: span for other, span in joined.items() if not _same(other, c, owners)},
                spans[c],
                max_offset_s,
                (near_s or {}).get(c),
            )
            for c in waiting
        }
        options = {c: alignment for c, alignment in found.items() if alignment is not None}
        if not options and partial:
            break
        if not options:
            raise NoSignalChange(
                f"camera {waiting[0]} shares no signal change with the other cameras",
                hint="Give the same signal id to heads that show the same phase in two cameras, and check that the "
                "recordings overlap in time.",
                camera=waiting[0],
            )
        camera_id = max(options, key=lambda c: (not options[c].is_ambiguous, options[c].taken.matched))
        taken = options[camera_id].taken
        alignments[camera_id] = options[camera_id]
        groups += _join(_of_others(groups, camera_id, owners), camera_id, changes[camera_id], taken)
        begin_s, end_s = spans[camera_id]
        joined[camera_id] = (_mapped(begin_s, taken), _mapped(end_s, taken))
        waiting.remove(camera_id)
    shared = sorted((group for group in groups if len(group.seen) >= 2), key=lambda group: group.time_s)
    return shared, {camera_id: alignments[camera_id] for camera_id in changes if camera_id in alignments}


def align(
    groups: Sequence[ChangeGroup],
    changes: Sequence[SignalChange],
    joined_s: Mapping[str, tuple[float, float]],
    span_s: tuple[float, float],
    max_offset_s: float | None = None,
    near_s: float | None = None,
) -> Alignment | None:
    """The offset under which the largest share of a camera's ``changes`` meets a group; None where none can.

    Of offsets that do equally well the one nearest to ``near_s`` is taken, else the smallest.

    Args:
        groups: changes of the cameras that have joined.
        changes: of the camera that is to join.
        joined_s: first and last time, on the reference clock, of the recordings that have joined.
        span_s: first and last time of the camera's recording, on its own clock.
        max_offset_s: of equally good offsets, smaller ones than this are preferred.
        near_s: an offset found otherwise.
    """
    pairs = _pairs(groups, changes)
    found = search(pairs, *_watched(groups, changes, joined_s, span_s))
    if not found:
        return None
    best = found[0]
    rivals = [c for c in found if c is not best and unlikelihood(best, c, found) < DECISIVE]

    def preferred(c: Candidate) -> tuple[float, ...]:
        if near_s is not None:
            return (abs(c.offset_s - near_s),)
        return (float(max_offset_s is not None and abs(c.offset_s) > max_offset_s), abs(c.offset_s))

    taken = min([best, *rivals], key=preferred)
    equals = [c for c in (best, *rivals) if c is not taken]
    worse = [c for c in found if c is not best and c not in rivals]
    told = [*((c, False) for c in equals), *((c, True) for c in worse[:_WORSE_TOLD])]
    decided = near_s is not None and abs(taken.offset_s - near_s) < _DECIDED_S
    return Alignment(_offset(taken, False), tuple(_offset(c, excluded) for c, excluded in told), decided)


def _offset(candidate: Candidate, excluded: bool) -> Offset:
    return Offset(candidate.offset_s, candidate.drift, candidate.matched, candidate.could, excluded)


def _mapped(time_s: float, clock: Offset) -> float:
    return time_s + clock.offset_s + clock.drift * time_s


def _span(changes: Sequence[SignalChange], recorded_s: tuple[float, float] | None) -> tuple[float, float]:
    times = [c.time_ns / 1e9 for c in changes]
    return recorded_s if recorded_s is not None else (min(times), max(times))


def _pairs(groups: Sequence[ChangeGroup], changes: Sequence[SignalChange]) -> Pairs:
    """All pairs of a group and a change of the same kind."""
    pairs = [
        (g, i)
        for g, group in enumerate(groups)
        for i, c in enumerate(changes)
        if group.key == (c.signal_id, c.before, c.after)
    ]
    index = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    times = np.array([c.time_ns / 1e9 for c in changes])
    own = np.array([c.half_interval_ns / 1e9 for c in changes])
    theirs = np.array([np.mean([c.half_interval_ns for c in group.seen.values()]) / 1e9 for group in groups])
    at = np.array([group.time_s for group in groups])
    g, i = index.T
    return Pairs(g, i, at[g], times[i], theirs[g] + own[i] + _SLACK_S)


def _watched(
    groups: Sequence[ChangeGroup],
    changes: Sequence[SignalChange],
    joined_s: Mapping[str, tuple[float, float]],
    span_s: tuple[float, float],
) -> tuple[list[Watched], list[Watched]]:
    """Groups that the camera could have seen, and its changes that those which have joined could have seen."""
    own = {(c.signal_id, c.before, c.after) for c in changes}
    theirs: dict[tuple[str, str, str], set[str]] = {}
    for group in groups:
        theirs.setdefault(group.key, set()).update(group.seen)
    first = [Watched(np.array([group.time_s for group in groups if group.key in own]), np.array([span_s]))]
    second = [
        Watched(
            np.array([c.time_ns / 1e9 for c in changes if (c.signal_id, c.before, c.after) == key]),
            _union([joined_s[camera_id] for camera_id in cameras]),
        )
        for key, cameras in theirs.items()
        if key in own
    ]
    return first, second


def _union(spans: Sequence[tuple[float, float]]) -> Array:
    merged: list[list[float]] = []
    for begin, end in sorted(spans):
        if merged and begin <= merged[-1][1]:
            merged[-1][1] = max(merged[-1][1], end)
        else:
            merged.append([begin, end])
    return np.array(merged)


def _same(one: str, other: str, owners: Mapping[str, str] | None) -> bool:
    """Whether two ids are of one camera."""
    return owners is not None and owners[one] == owners[other]


def _of_others(groups: Sequence[ChangeGroup], camera_id: str, owners: Mapping[str, str] | None) -> list[ChangeGroup]:
    """Groups that no other segment of the camera has seen."""
    return [group for group in groups if not any(_same(other, camera_id, owners) for other in group.seen)]


def _join(
    groups: Sequence[ChangeGroup], camera_id: str, changes: Sequence[SignalChange], clock: Offset
) -> list[ChangeGroup]:
    """Add a camera's changes to the groups they meet; the rest open groups of their own, which are returned."""
    pairs = _pairs(groups, changes)
    residual = np.abs(pairs.first_s - pairs.second_s - clock.offset_s - clock.drift * pairs.second_s)
    near = np.flatnonzero(residual <= pairs.tolerance_s)
    kept = near[one_to_one(pairs.first[near], pairs.second[near], residual[near])]
    joined = set(pairs.second[kept].tolist())
    for k in kept:
        groups[int(pairs.first[k])].seen[camera_id] = changes[int(pairs.second[k])]
    return [
        ChangeGroup(c.signal_id, c.before, c.after, _mapped(c.time_ns / 1e9, clock), {camera_id: c})
        for i, c in enumerate(changes)
        if i not in joined
    ]
