"""Rauch–Tung–Striebel smoothing: every state from all measurements, earlier and later."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.se3 import normalise_angle
from wibam_core.tracking.motion import STATES, YAW, Belief, Measurement, MotionModel, times, transposed, update

Indices = NDArray[np.int64]


def smooth(
    model: MotionModel,
    lengths: Indices,
    times_ns: Indices,
    measurements: Measurement,
    measured: NDArray[np.bool_],
    stands: NDArray[np.bool_],
) -> Belief:
    """Smoothed beliefs of K road users at S instants in all, one road user's after another's.

    All of them advance together, each from its own first instant on.

    Args:
        model: how the K move.
        lengths: (K,) at how many instants each is to be known; at least 1.
        times_ns: (S,) instants, ascending for each.
        measurements: (S,); what they say at instants that were not measured is not looked at.
        measured: (S,) which instants were; the first of each was, the others are bridged.
        stands: (S,) at which it is known to stand: its speed is zero there (a zero-velocity update: Foxlin, "Pedestrian
            tracking with shoe-mounted inertial sensors", IEEE CG&A 2005), and between two such instants nothing moves.
    """
    order = np.argsort(-lengths, kind="stable")
    model, first = model.where(order), (np.cumsum(lengths) - lengths)[order]
    going = np.searchsorted(-lengths[order], -np.arange(lengths.max()))  # how many are longer than so many instants
    states, predicted = _empty(len(times_ns)), _empty(len(times_ns))
    steps = np.empty((len(times_ns), STATES, STATES))
    _put(states, first, model.first_belief(measurements.where(first)))
    _halt(states, first[stands[first]], model.where(stands[first]))
    for k, count in enumerate(going[1:], 1):
        rows, own = first[:count] + k, model.where(slice(count))
        expected, steps[rows] = own.predict(states.where(rows - 1), (times_ns[rows] - times_ns[rows - 1]) * 1e-9)
        still = np.flatnonzero(stands[rows] & stands[rows - 1])
        _put(expected, still, states.where(rows[still] - 1))
        steps[rows[still]] = np.eye(STATES)
        _put(predicted, rows, expected)
        _put(states, rows, expected)
        seen = np.flatnonzero(measured[rows])
        updated = update(own.where(seen), expected.where(seen), measurements.where(rows[seen]))
        _put(states, rows[seen], updated)
        _halt(states, rows[stands[rows]], own.where(stands[rows]))
    for k in range(len(going) - 1, 0, -1):
        ahead = first[: going[k]] + k
        now, expected = states.where(ahead - 1), predicted.where(ahead)
        gain = transposed(np.linalg.solve(expected.covariance, steps[ahead] @ now.covariance))
        difference = states.mean[ahead] - expected.mean
        difference[:, YAW] = normalise_angle(difference[:, YAW])
        mean = now.mean + times(gain, difference)
        mean[:, YAW] = normalise_angle(mean[:, YAW])
        covariance = now.covariance + gain @ (states.covariance[ahead] - expected.covariance) @ transposed(gain)
        _put(states, ahead - 1, Belief(mean, 0.5 * (covariance + transposed(covariance))))
    return states


def _empty(count: int) -> Belief:
    return Belief(np.empty((count, STATES)), np.empty((count, STATES, STATES)))


def _halt(beliefs: Belief, rows: Indices, model: MotionModel) -> None:
    """Take in that those of these rows stand, who move by this model."""
    _put(beliefs, rows, model.halted(beliefs.where(rows)))


def _put(beliefs: Belief, rows: Indices, values: Belief) -> None:
    beliefs.mean[rows], beliefs.covariance[rows] = values.mean, values.covariance
