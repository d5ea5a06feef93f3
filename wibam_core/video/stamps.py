"""From the stamps of a file's packets to segments on one ascending clock. Pure functions of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_S = 1_000_000_000
#: Decoding order and presentation order differ by at most so many frames: the largest buffer of H.264 and H.265.
REORDER_FRAMES = 17
#: A step forward of more is no time without frames but a clock that was set, e.g. by a time server.
LONGEST_PAUSE_NS = 3600 * _S
#: After a time without frames of at least this a new segment begins.
SEGMENT_PAUSE_NS = 10 * _S
#: Frames on another clock for less than this are stray stamps, not a segment.
_STRAY_NS = _S // 2
#: A step that is a multiple of the counter's period but for this is the counter's wrapping.
_WRAP_TOLERANCE_NS = 60 * _S
_BLOCK = 64
#: So many stray stamps in a row, each on a clock of its own, are passed over.
_LOOK_AHEAD = 13
#: A clock that was set back shows the time that passed to within this share.
_SET_BACK_SHARE = 0.1
#: More steps back than this are no reordering.
_BACKWARDS = 0.6
#: Where a larger share of all steps goes back, frames are reordered throughout the file.
_REORDERED_SHARE = 0.02
#: Frames that are reordered have, once sorted, intervals of so many usual ones. A clock that was set back says times
#: that lie among earlier ones: half an interval or less from one of them.
_EVEN = (0.6, 1.6)


@dataclass(frozen=True, eq=False)
class Stretch:
    """Frames of one clock without a jump.

    Attributes:
        indices: (M,) which stamps, ascending.
        jump_before: its clock has nothing to do with that of the stretch before; False of the first one.
    """

    indices: IntArray
    jump_before: bool


@dataclass(frozen=True, eq=False)
class Sorted:
    """Stamps in segments.

    Attributes:
        times_ns: (N,) times on one clock, on which all kept stamps differ and segments follow one another.
        kept: (N,) whether the frame is used; the others have stray stamps, or one that another frame has.
        segments: the stretches, without what is not kept.
        usual_ns: the usual interval between frames.
        stray: how many stamps were stray.
    """

    times_ns: IntArray
    kept: BoolArray
    segments: tuple[Stretch, ...]
    usual_ns: int
    stray: int


def usual_interval_ns(times_ns: IntArray) -> int:
    """Median interval of times (N,) that are nearly in order; N ≥ 2 of them must differ."""
    padded = len(times_ns) // _BLOCK * _BLOCK
    blocks = [times_ns[:padded].reshape(-1, _BLOCK), times_ns[padded:].reshape(1, -1)]
    intervals = np.concatenate([np.diff(np.sort(block, axis=1)).ravel() for block in blocks])
    positive = intervals[intervals > 0]
    return int(np.median(positive)) if len(positive) else _S


def unwrapped_ns(times_ns: IntArray, period_ns: float) -> IntArray:
    """Times (N,) of a counter that starts again at 0 after ``period_ns``, as if it had gone on."""
    steps = np.diff(times_ns)
    turns = np.rint(steps / period_ns).astype(np.int64)
    turns[np.abs(steps - turns * period_ns) > _WRAP_TOLERANCE_NS] = 0
    gone_ns = np.rint(np.cumsum(turns) * period_ns).astype(np.int64)
    return times_ns - np.concatenate([np.zeros(1, dtype=np.int64), gone_ns])


def sort_stamps(times_ns: IntArray, usual_ns: int | None = None) -> Sorted:
    """Find the segments of a file, and bring them onto one clock, the first one's.

    A lasting jump backwards, or forwards by more than an hour, is a clock that was set: how long the camera was off is
    unknown, and its frames are put right behind those before. A shorter jump forwards is a time without frames. A clock
    that was set back again shows by its stamps that no time was lost. A few frames on another clock have stray stamps.

    Args:
        times_ns: (N,) stamps in decoding order, N ≥ 1.
        usual_ns: the usual interval, where it is known from elsewhere; it must be for N = 1.
    """
    usual_ns = usual_interval_ns(times_ns) if usual_ns is None else usual_ns
    if int(np.count_nonzero(np.diff(times_ns) < 0)) > _REORDERED_SHARE * (len(times_ns) - 1):
        return _sorted(times_ns, usual_ns, reordered=True)
    order = _shown_order(times_ns, usual_ns)
    found = _sorted(times_ns[order], usual_ns, reordered=False)
    place = np.argsort(order)
    segments = tuple(replace(each, indices=np.sort(order[each.indices])) for each in found.segments)
    return replace(found, times_ns=found.times_ns[place], kept=found.kept[place], segments=segments)


def _shown_order(times_ns: IntArray, usual_ns: int) -> IntArray:
    """Which of stamps (N,) in decoding order comes when, where frames are reordered here and there.

    An encoder that uses frames predicted from both sides only where they save much writes a few of them in a whole
    recording. With the frame before which they are shown they fill its stretch of time evenly, and are put in order;
    stamps that go back for another reason do not, and stay where they are.
    """
    order = np.arange(len(times_ns))
    shown, end = times_ns.copy(), 0
    for first in np.flatnonzero(np.diff(times_ns) < 0).tolist():
        if first < end:
            continue
        later = np.flatnonzero(times_ns[first + 1 : first + REORDER_FRAMES] >= shown[first])
        group = slice(first, first + 1 + int(later[0]) if len(later) else first + REORDER_FRAMES)
        by_time = np.argsort(shown[group], kind="stable")
        intervals = np.diff(np.append(shown[max(first - 1, 0) : first], shown[group][by_time])) / usual_ns
        if intervals.min() > _EVEN[0] and intervals.max() < _EVEN[1]:
            end = group.stop
            order[group], shown[group] = order[group][by_time], shown[group][by_time]
    return order


def _sorted(times_ns: IntArray, usual_ns: int, *, reordered: bool) -> Sorted:
    """As `sort_stamps`; frames that are not reordered come in the order shown."""
    back_ns = (REORDER_FRAMES if reordered else 1.5) * usual_ns
    forward_ns = (1.5 * REORDER_FRAMES if reordered else 3) * usual_ns
    steps = _Steps(usual_ns, back_ns, forward_ns)
    stretches, stray = _without_stray(times_ns, _runs(times_ns, steps), steps)
    times, kept = times_ns.copy(), np.zeros(len(times_ns), dtype=bool)
    segments: list[Stretch] = []
    shifts_ns: list[int] = []
    last_ns = shift_ns = 0
    goes_on = _set_and_set_back(times_ns, stretches, usual_ns)
    for number, found in enumerate(stretches):
        stretch = found if number not in goes_on.away else replace(found, jump_before=True)
        of_it = times_ns[stretch.indices]
        before = goes_on.after.get(number)
        if before is not None:
            shift_ns = max(shifts_ns[before], last_ns + usual_ns - int(of_it.min()))
            stretch = replace(stretch, jump_before=False)
        elif stretch.jump_before:
            shift_ns = last_ns + usual_ns - int(of_it.min())
        shifts_ns.append(shift_ns)
        times[stretch.indices] = of_it + shift_ns
        used = stretch.indices[_distinct(of_it, reordered)]
        kept[used] = True
        segments.append(Stretch(used, stretch.jump_before))
        last_ns = int(of_it.max()) + shift_ns
    return Sorted(times, kept, tuple(segments), usual_ns, stray)


@dataclass(frozen=True)
class _Steps:
    """The usual interval, and how far stamps may go back and forward between two frames without a jump, ns."""

    usual_ns: int
    back_ns: float
    forward_ns: float

    @property
    def few(self) -> int:
        """Frames on another clock that are stray if no more follow."""
        return max(1, _STRAY_NS // self.usual_ns)


def _runs(times_ns: IntArray, steps: _Steps) -> list[IntArray]:
    """Indices of stamps between which there is no step too far back or forward."""
    starts, latest = [0], int(times_ns[0])
    for index, time in enumerate(times_ns.tolist()):
        if time < latest - steps.back_ns or time > latest + steps.forward_ns:
            starts.append(index)
            latest = time
        elif time > latest:
            latest = time
    return [np.arange(a, b) for a, b in zip(starts, [*starts[1:], len(times_ns)], strict=True)]


def _without_stray(times_ns: IntArray, runs: Sequence[IntArray], steps: _Steps) -> tuple[list[Stretch], int]:
    """Runs joined where one goes on with another's clock, without the few frames between that do not."""
    joined: list[tuple[list[IntArray], bool]] = []
    stray = at = frames = last_ns = 0
    while at < len(runs):
        run = runs[at]
        first_ns = int(times_ns[run].min())
        ends, short = at + 1 == len(runs), len(run) <= steps.few
        if not joined:
            if short and not ends and len(runs[at + 1]) > steps.few and _is_apart(times_ns, run, runs[at + 1]):
                stray += len(run)
                at += 1
                continue
            joined.append(([run], False))
            frames = 0
        elif (back := _returns(times_ns, last_ns, runs[at : at + _LOOK_AHEAD], steps)) is not None:
            stray += sum(len(passed) for passed in runs[at : at + back])
            at += back
            run = runs[at]
            joined[-1][0].append(run)
        elif 0 < first_ns - last_ns < SEGMENT_PAUSE_NS:
            joined[-1][0].append(run)
        else:
            jumped = not 0 < first_ns - last_ns <= LONGEST_PAUSE_NS
            if short and ends and frames > steps.few:
                stray += len(run)
                break
            joined.append(([run], jumped))
            frames = 0
        frames += len(run)
        last_ns = int(times_ns[run].max())
        at += 1
    return [Stretch(np.concatenate(parts), jumped) for parts, jumped in joined], stray


@dataclass(frozen=True)
class _GoesOn:
    """Stretches that go on with the clock of an earlier one, and those between, on a clock that was set meanwhile.

    Attributes:
        after: number of a stretch -> number of the earlier one.
        away: numbers of those between.
    """

    after: dict[int, int]
    away: frozenset[int]


def _set_and_set_back(times_ns: IntArray, stretches: Sequence[Stretch], usual_ns: int) -> _GoesOn:
    """Find clocks that were set and set back: from before to after, just the time passed that frames between take."""
    firsts = [int(times_ns[stretch.indices].min()) for stretch in stretches]
    lasts = [int(times_ns[stretch.indices].max()) for stretch in stretches]
    after: dict[int, int] = {}
    away: set[int] = set()
    for number in range(2, len(stretches)):
        between_ns = usual_ns
        for before in range(number - 2, -1, -1):
            between_ns += usual_ns * len(stretches[before + 1].indices)
            passed_ns = firsts[number] - lasts[before]
            if before not in away and abs(passed_ns - between_ns) <= _SET_BACK_SHARE * between_ns + usual_ns:
                after[number] = before
                away |= set(range(before + 1, number))
                break
    return _GoesOn(after, frozenset(away))


def run_backwards(times_ns: IntArray) -> bool:
    """Whether stamps (N,) in decoding order descend; where frames are reordered, at most half of their steps do."""
    return int(np.count_nonzero(np.diff(times_ns) < 0)) > _BACKWARDS * (len(times_ns) - 1)


def _is_apart(times_ns: IntArray, before: IntArray, after: IntArray) -> bool:
    """Whether the clock was set between two runs, or nothing was seen for long."""
    step = int(times_ns[after].min()) - int(times_ns[before].max())
    return step <= 0 or step > SEGMENT_PAUSE_NS


def _returns(times_ns: IntArray, last_ns: int, runs: Sequence[IntArray], steps: _Steps) -> int | None:
    """How many of the runs, each of a few frames, are stray: the one behind them goes on after ``last_ns``."""
    passed = 0
    for number, run in enumerate(runs):
        first = int(times_ns[run].min())
        goes_on = -steps.back_ns < first - last_ns <= steps.forward_ns + 1.5 * passed * steps.usual_ns
        astray = any(times_ns[other].max() >= first or times_ns[other].min() <= last_ns for other in runs[:number])
        if number and goes_on and astray:
            return number
        if len(run) > steps.few:
            return None
        passed += len(run)
    return None


def _distinct(times_ns: IntArray, reordered: bool) -> BoolArray:
    """Of times in decoding order those that can be told apart: the first of equal ones, and no step back where
    frames are not reordered."""
    if reordered:
        first = np.zeros(len(times_ns), dtype=bool)
        first[np.unique(times_ns, return_index=True)[1]] = True
        return first
    latest = np.maximum.accumulate(times_ns)
    return np.concatenate([[True], times_ns[1:] > latest[:-1]])
