"""Which changes of several cameras are one and the same, before any clock is known.

Cameras join one by one, the one that shares most with those already joined first. Each is shifted by the offset under
which most of its changes meet a change of the same signal and the same transition (a vote over all pairwise
differences). Signals are periodic, so several offsets may do equally well: the smallest is taken and the others are
reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wibam_core.errors import NoSignalChange
from wibam_core.scene import SignalChange

Array = NDArray[np.float64]

#: Clocks of cameras run at most this wrong against each other (crystals: ±100 ppm).
MAX_DRIFT = 1e-4
#: Lamps need some time to light up, and rows of a frame are exposed one after another.
_SLACK_S = 0.02
#: Offsets under which nearly as many changes meet are reported as alternatives.
_ALTERNATIVE_SHARE = 0.8


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
class Alignment:
    """How one camera's changes meet those of the others.

    Attributes:
        offset_s: add to the camera's time for the reference time, before refinement.
        matched: changes that meet another camera's.
        alternatives: (offset_s, matched) of other offsets that do nearly as well, best first.
    """

    offset_s: float
    matched: int
    alternatives: tuple[tuple[float, int], ...] = ()

    @property
    def is_ambiguous(self) -> bool:
        """Whether another offset does exactly as well."""
        return any(matched >= self.matched for _, matched in self.alternatives)


def match_changes(
    changes: Mapping[str, Sequence[SignalChange]], reference_id: str, max_offset_s: float
) -> tuple[list[ChangeGroup], dict[str, Alignment]]:
    """Group the changes of all cameras.

    Args:
        changes: camera id -> its changes; every camera of the site.
        reference_id: the camera whose clock is kept.
        max_offset_s: largest offset from it that is looked for.

    Returns:
        groups seen by at least two cameras, by time, and the alignment of every camera but the reference.

    Raises:
        NoSignalChange: naming a camera that saw no change, or none that another camera saw.
    """
    for camera_id, seen in changes.items():
        if not seen:
            raise NoSignalChange(f"no signal change was seen in camera {camera_id}", camera=camera_id)
    groups = [
        ChangeGroup(c.signal_id, c.before, c.after, c.time_ns / 1e9, {reference_id: c}) for c in changes[reference_id]
    ]
    alignments: dict[str, Alignment] = {}
    waiting = [camera_id for camera_id in changes if camera_id != reference_id]
    while waiting:
        options = {camera_id: align(groups, changes[camera_id], max_offset_s) for camera_id in waiting}
        camera_id = max(waiting, key=lambda c: options[c].matched)
        if options[camera_id].matched == 0:
            raise NoSignalChange(
                f"camera {camera_id} shares no signal change with the other cameras",
                hint="Give the same signal id to heads that show the same phase in two cameras, "
                "or raise sync.max_offset_s if the recordings started far apart.",
                camera=camera_id,
            )
        alignments[camera_id] = options[camera_id]
        _join(groups, camera_id, changes[camera_id], options[camera_id].offset_s)
        waiting.remove(camera_id)
    shared = sorted((group for group in groups if len(group.seen) >= 2), key=lambda group: group.time_s)
    return shared, {camera_id: alignments[camera_id] for camera_id in changes if camera_id in alignments}


def align(groups: Sequence[ChangeGroup], changes: Sequence[SignalChange], max_offset_s: float) -> Alignment:
    """The offset under which most of a camera's ``changes`` meet a group; the smallest of equally good ones."""
    times, widths, pairs = _pairs(groups, changes)
    if len(pairs) == 0:
        return Alignment(0.0, 0)
    differences = np.array([groups[g].time_s for g, _ in pairs]) - times[pairs[:, 1]]
    close = np.abs(differences) <= max_offset_s
    pairs, differences = pairs[close], differences[close]
    if len(pairs) == 0:
        return Alignment(0.0, 0)
    span = float(np.ptp(times)) * MAX_DRIFT
    tight = widths[pairs[:, 0], pairs[:, 1]] + span + _SLACK_S
    found: list[tuple[float, int, float]] = []
    for candidate in np.unique(differences):
        near = np.abs(differences - candidate) <= 2 * tight
        offset = float(np.median(differences[near]))
        residual = np.abs(differences - offset)
        matched, error = _one_to_one(pairs, residual, tight)
        found.append((offset, matched, error))
    found.sort(key=lambda f: (-f[1], f[2]))
    distinct: list[tuple[float, int, float]] = []
    width = 2 * float(np.median(tight))
    for option in found:
        if all(abs(option[0] - other[0]) > width for other in distinct):
            distinct.append(option)
    most = distinct[0][1]
    best = min((option for option in distinct if option[1] == most), key=lambda option: abs(option[0]))
    others = [o for o in distinct if o is not best and o[1] >= _ALTERNATIVE_SHARE * most]
    return Alignment(best[0], most, tuple((offset, matched) for offset, matched, _ in others[:5]))


def _pairs(groups: Sequence[ChangeGroup], changes: Sequence[SignalChange]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Times (n,) of the changes, (groups, n) sums of half intervals, and (p, 2) indices of pairs of the same kind."""
    times = np.array([c.time_ns / 1e9 for c in changes])
    own = np.array([c.half_interval_ns / 1e9 for c in changes])
    theirs = np.array([np.mean([c.half_interval_ns for c in group.seen.values()]) / 1e9 for group in groups])
    pairs = [
        (g, i)
        for g, group in enumerate(groups)
        for i, c in enumerate(changes)
        if group.key == (c.signal_id, c.before, c.after)
    ]
    return times, theirs[:, None] + own, np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _one_to_one(pairs: NDArray[np.int64], residual: Array, tolerance: Array) -> tuple[int, float]:
    """How many pairs within tolerance remain when each side is used once (closest first), and their mean residual."""
    taken_groups: set[int] = set()
    taken_changes: set[int] = set()
    total = 0.0
    for k in np.argsort(residual, kind="stable"):
        g, i = int(pairs[k, 0]), int(pairs[k, 1])
        if residual[k] <= tolerance[k] and g not in taken_groups and i not in taken_changes:
            taken_groups.add(g)
            taken_changes.add(i)
            total += float(residual[k])
    return len(taken_groups), total / max(len(taken_groups), 1)


def _join(groups: list[ChangeGroup], camera_id: str, changes: Sequence[SignalChange], offset_s: float) -> None:
    """Add a camera's changes to the groups they meet; the rest open groups of their own."""
    times, widths, pairs = _pairs(groups, changes)
    residual = np.array([abs(groups[g].time_s - times[i] - offset_s) for g, i in pairs])
    span = float(np.ptp(times)) * MAX_DRIFT
    joined: set[int] = set()
    for k in np.argsort(residual, kind="stable"):
        g, i = int(pairs[k, 0]), int(pairs[k, 1])
        if residual[k] <= widths[g, i] + span + _SLACK_S and camera_id not in groups[g].seen and i not in joined:
            groups[g].seen[camera_id] = changes[i]
            joined.add(i)
    for i, c in enumerate(changes):
        if i not in joined:
            groups.append(ChangeGroup(c.signal_id, c.before, c.after, times[i] + offset_s, {camera_id: c}))
