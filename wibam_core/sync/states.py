"""From evidence per frame to the sequence of signal states, by a hidden Markov model.

States follow the cycle green → amber → red (→ red_amber) → green. Evidence counts by time, not by frame, so that a
recording at 50 frames per second is not eight times surer of a passing truck than one at 6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wibam_core.sync.lamps import AMBER, GREEN, RED

Array = NDArray[np.float64]

STATES = ("red", "amber", "green", "red_amber")
#: Evidence that any frame gives for any state: an unlit or hidden head says nothing.
_FLOOR = 0.15
#: Frames closer than this share their evidence; a frame farther from the next counts at most twice this.
_CORRELATION_S = 0.2
#: What it costs, as a negative logarithm of a probability, to go on to the next state of the cycle, and to any other.
_NORMAL_COST = 3.0
_ODD_COST = 8.0
_NORMAL = {("green", "amber"), ("amber", "red"), ("red", "green"), ("red", "red_amber"), ("red_amber", "green")}
#: No signal leaves a state and returns to it within this time, since amber alone takes 3 s (RiLSA 2015; MUTCD 2009,
#: 4D.26: 3 to 6 s); what looks so is an occlusion or a reflection, or blinking.
MIN_EXCURSION_S = 2.5


def state_evidence(lit: Array, trust: Array) -> Array:
    """(T, 4) evidence in [0, 1] for each of `STATES`, from lit (T, 3) and trust (T,) of `Lamps.unmix`.

    It is small for all states where no lamp, or an impossible pair, is lit.
    """
    red, amber, green = lit[:, RED], lit[:, AMBER], lit[:, GREEN]
    evidence = np.stack(
        [
            red * (1 - amber) * (1 - green),
            amber * (1 - red) * (1 - green),
            green * (1 - red) * (1 - amber),
            red * amber * (1 - green),
        ],
        axis=1,
    )
    return evidence * trust[:, None]


def switch_costs(seen: tuple[bool, bool, bool]) -> Array:
    """(4, 4) cost of going from one state to another, for a head whose lamps of `COLOURS` were ``seen`` lit."""
    usable = {"red": seen[RED], "amber": seen[AMBER], "green": seen[GREEN], "red_amber": seen[RED] and seen[AMBER]}
    costs = np.full((len(STATES), len(STATES)), np.inf)
    for i, before in enumerate(STATES):
        for j, after in enumerate(STATES):
            if i == j:
                costs[i, j] = 0.0
            elif usable[before] and usable[after]:
                normal = (before, after) in _NORMAL or not seen[AMBER]
                costs[i, j] = _NORMAL_COST if normal else _ODD_COST
    return costs


def most_likely_states(times_ns: NDArray[np.int64], evidence: Array, costs: Array) -> NDArray[np.int64]:
    """(T,) most likely state of every frame (Viterbi).

    Args:
        times_ns: (T,) increasing.
        evidence: (T, 4), see `state_evidence`.
        costs: (4, 4), see `switch_costs`.
    """
    if len(times_ns) == 0:
        return np.zeros(0, dtype=np.int64)
    gap_s = np.diff(times_ns, append=times_ns[-1] + np.int64(_CORRELATION_S * 1e9)) / 1e9
    weight = np.minimum(gap_s / _CORRELATION_S, 2.0)
    gain = np.log((evidence + _FLOOR) / _FLOOR) * weight[:, None]
    came_from = np.zeros(gain.shape, dtype=np.int64)
    score = gain[0].copy()
    columns = np.arange(len(STATES))
    for t in range(1, len(gain)):
        options = score[:, None] - costs
        came_from[t] = np.argmax(options, axis=0)
        score = options[came_from[t], columns] + gain[t]
    path = np.empty(len(gain), dtype=np.int64)
    path[-1] = int(np.argmax(score))
    for t in range(len(gain) - 1, 0, -1):
        path[t - 1] = came_from[t, path[t]]
    return _without_excursions(times_ns, path)


def _without_excursions(times_ns: NDArray[np.int64], path: NDArray[np.int64]) -> NDArray[np.int64]:
    """``path`` with every return to a state within `MIN_EXCURSION_S` of leaving it made one stay."""
    path = path.copy()
    begin = 1
    while begin < len(path):
        if path[begin] != path[begin - 1]:
            end = int(np.searchsorted(times_ns, times_ns[begin] + np.int64(MIN_EXCURSION_S * 1e9)))
            back = np.flatnonzero(path[begin:end] == path[begin - 1])
            if len(back):
                path[begin : begin + back[-1]] = path[begin - 1]
        begin += 1
    return path
