"""What the rounding of light changes to frames does to the clocks that are found from them.

A change is seen between two frames, and where between them is not known: an error as uniform as the frame's phase is
random. But such errors are no independent draws. A signal that repeats itself, or that is switched in steps of a tenth
of a second, meets a camera whose frames are in step with it at the same phase again and again: then all its changes are
wrong by the same amount, of which their residuals say nothing.

So each camera's errors are what its frames make of the changes' times: the sawtooth of the time since the last frame.
How the changes' times lie towards each other follows from all cameras (`regular_times`); at which phase of its frames a
camera meets them is unknown, and every phase is as likely (`rounding_covariance`).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

#: Signal, state before, state after.
Kind = tuple[str, str, str]
Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Controllers switch in steps of this.
_STEP_S = 0.1
#: Clocks of cameras differ from that of a controller by no more than this.
_MAX_DRIFT = 2e-3
#: A pattern is believed if no more than one in so many sets of random times looks as regular.
_SIGNIFICANCE = 1000.0
#: How much of the regularity that the times' standard deviations leave must be seen.
_SEEN_SHARE = 0.8
#: Changes that follow each other within this time may do so always after the same time.
_FOLLOWS_S = 40.0
#: They do where so many were seen, so large a share of which is as near to the middle one as their standard deviations.
_LEAST_FOLLOWING = 2
_ALWAYS = 0.8
_NEAR_SDS = 2.5
#: Phases of a camera's frames that are tried.
_PHASES = 32
#: Frame intervals that differ by less than this from the usual one are whole ones: nothing hid the change.
_WHOLE = 0.2


def regular_times(kinds: Sequence[Kind], times_s: Array, sd_s: Array) -> tuple[Array, IntArray]:
    """Times of changes, less the errors that break their own regularity, and which of them hang together.

    Args:
        kinds: (G,) which signal changed, from what to what.
        times_s: (G,) estimates, ascending.
        sd_s: (G,) their standard deviations.

    Returns:
        times (G,): on a grid of tenths of a second where they lie on one; else those that always follow each other
        after the same time do so exactly, and all others are as they were. And (G,) the number of the set that each
        belongs to: all of a grid, or all that are tied to each other.
    """
    tied, sets = _following(kinds, times_s, sd_s)
    stepped = _stepped(times_s, sd_s, len(np.unique(sets)))
    return (tied, sets) if stepped is None else (stepped, np.zeros(len(times_s), np.int64))


def rounding_covariance(
    gain: Array, camera: IntArray, together: IntArray, half_s: Array, late_s: Array, slides: Array
) -> Array:
    """Covariance (U, U) of unknowns that are a linear function of rounded times.

    Args:
        gain: (U, M) by how much each observation moves each unknown.
        camera: (M,) whose observation it is.
        together: (M,) number of the set of changes that it belongs to; those of different sets are at phases that have
            nothing to do with each other.
        half_s: (M,) half the time between the frames that hold the change.
        late_s: (M,) the change's time minus the middle of these frames, but for an unknown phase of each camera.
        slides: (S, M) other ways in which the changes may lie towards the frames, each as likely: added to ``late_s``.
    """
    total = np.zeros((len(gain), len(gain)))
    phases = (np.arange(_PHASES) + 0.5) / _PHASES
    for number in np.unique(camera):
        rows = np.flatnonzero(camera == number)
        usual = float(np.median(half_s[rows]))
        whole = np.abs(half_s[rows] - usual) <= _WHOLE * usual
        regular, other = rows[whole], rows[~whole]
        total += (gain[:, other] * half_s[other] ** 2 / 3.0) @ gain[:, other].T
        if not len(regular):
            continue
        order = np.argsort(together[regular], kind="stable")
        regular = regular[order]
        half = half_s[regular]
        bounds = np.flatnonzero(np.diff(together[regular], prepend=-1))
        for slide in slides[:, regular]:
            since = np.mod((half + late_s[regular] + slide)[:, None] + 2 * half[:, None] * phases, 2 * half[:, None])
            error = half[:, None] - since
            moved = np.add.reduceat(gain[:, regular, None] * error, bounds, axis=1).reshape(len(gain), -1)
            total += moved @ moved.T / (_PHASES * len(slides))
    return total


def _stepped(times_s: Array, sd_s: Array, independent: int) -> Array | None:
    """The times on a grid of `_STEP_S` of a controller's clock; None where they do not lie on one.

    Args:
        times_s: (G,).
        sd_s: (G,) their standard deviations.
        independent: how many of them are not tied to earlier ones: only these tell.
    """
    if independent < 2:
        return None
    since = times_s - times_s.mean()
    reach = max(float(np.ptp(since)), _STEP_S)
    steps = int(np.ceil(_MAX_DRIFT * reach / _STEP_S * 4))
    drifts = np.arange(-steps, steps + 1) * (_STEP_S / reach / 4)
    turns = np.exp(2j * np.pi * np.outer(1 + drifts, since) / _STEP_S).mean(axis=1)
    usual = float(np.exp(-2 * (np.pi * sd_s / _STEP_S) ** 2).mean())
    by_chance = float(np.sqrt(np.log(_SIGNIFICANCE * len(drifts)) / independent))
    best = int(np.argmax(np.abs(turns)))
    if abs(turns[best]) < max(_SEEN_SHARE * usual, by_chance):
        return None
    phase_s = float(np.angle(turns[best])) / (2 * np.pi) * _STEP_S
    number = np.rint((since * (1 + drifts[best]) - phase_s) / _STEP_S)
    line = np.polynomial.Polynomial.fit(number, times_s, 1)
    return np.asarray(line(number), dtype=np.float64)


def _following(kinds: Sequence[Kind], times_s: Array, sd_s: Array) -> tuple[Array, IntArray]:
    """The times such that changes which always follow each other after the same time do so exactly; sets of such."""
    found: dict[Hashable, list[tuple[int, int]]] = {}
    for i, kind in enumerate(kinds):
        after: set[Hashable] = set()
        for j in range(i + 1, len(kinds)):
            if times_s[j] - times_s[i] > _FOLLOWS_S:
                break
            # These two signals, and any two: amber lasts as long at all of them.
            for key in ((kind, kinds[j]), (kind[0] == kinds[j][0], kind[1:], kinds[j][1:])):
                if key not in after:
                    after.add(key)
                    found.setdefault(key, []).append((i, j))
    links: dict[int, tuple[int, float]] = {}
    for pairs in found.values():
        if len(pairs) < _LEAST_FOLLOWING:
            continue
        i, j = np.array(pairs).T
        lasted = times_s[j] - times_s[i]
        near = np.abs(lasted - np.median(lasted)) <= _NEAR_SDS * np.hypot(sd_s[i], sd_s[j])
        if near.mean() < _ALWAYS:
            continue
        mean = float(lasted[near].mean())
        for k in np.flatnonzero(near).tolist():
            before, later = pairs[k]
            if later not in links or links[later][0] < before:
                links[later] = before, mean
    regular, cluster = times_s.copy(), np.arange(len(times_s))
    for later in range(len(times_s)):
        if later in links:
            before, mean = links[later]
            regular[later], cluster[later] = regular[before] + mean, cluster[before]
    for number in np.unique(cluster):
        rows = cluster == number
        regular[rows] += (times_s[rows] - regular[rows]).mean()
    return regular, cluster
