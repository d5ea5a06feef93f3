"""Rauch–Tung–Striebel smoothing: every state from what all cameras measured, earlier and later.

A camera that sees a vehicle 0.2 m too far away sees it so in its next frame, too. Taken for independent, such errors
would bend a track to whichever cameras happen to see it. So what lasts of each camera's errors is a state of its own
beside those of the motion (Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation",
2001), and so is an acceleration that lasts: who brakes goes on braking (Singer, "Estimating optimal tracking filter
performance for manned maneuvering targets", IEEE TAES 1970).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.se3 import normalise_angle
from wibam_core.tracking.motion import (
    STATES,
    YAW,
    Array,
    Belief,
    Measurement,
    MotionModel,
    Rows,
    diagonal,
    loosened,
    times,
    transposed,
)

Indices = NDArray[np.int64]

#: So much of the variance of what a camera measures lasts, for so long (its correlation falls to 1/e). Of a fine-tuned
#: network on rendered sites it is 0.8 (benchmarks/network_errors.json), most of which stays for as long as it was seen.
_LASTING_SHARE, _LASTING_S = 0.7, 4.0
#: How long a vehicle goes on speeding up or braking, s.
_ACCELERATING_S = 1.0
#: The first box of a road user says where to begin, and is measured after that: it counts for this much less then.
_FIRST_DOUBT = np.array([10.0, 10.0, 3.0])
#: Standard deviation of the speed of somebody who is seen to stand, m/s.
_HALTED_SD_MPS = 0.05
#: In the model of driving the speed along the heading, in the state that is smoothed the acceleration along it.
_SPEED, _ACCELERATION = STATES - 2, STATES
_MOTION = STATES + 1


@dataclass(frozen=True, eq=False)
class Views:
    """What C cameras measured of road users at S instants.

    Attributes:
        values, sd: (S, C, 3) centre and yaw, m and rad, with standard deviations; the yaw is known up to half a turn.
        seen: (S, C) whether that camera did; else its values are not looked at.
    """

    values: Array
    sd: Array
    seen: NDArray[np.bool_]

    def where(self, rows: Rows) -> Views:
        """Those of the selected instants."""
        return Views(self.values[rows], self.sd[rows], self.seen[rows])


def smooth(
    model: MotionModel,
    accelerations_mps2: Array,
    lengths: Indices,
    times_ns: Indices,
    first: Measurement,
    views: Views,
    stands: NDArray[np.bool_],
) -> Belief:
    """Smoothed beliefs of K road users at S instants in all, one road user's after another's.

    All of them advance together, each from its own first instant on.

    Args:
        model: how the K move, but for accelerations that last.
        accelerations_mps2: (K,) standard deviation of these; 0 for those who have none.
        lengths: (K,) at how many instants each is to be known; at least 1.
        times_ns: (S,) instants, ascending for each.
        first: (K,) where about each was at its first instant, and its heading.
        views: (S,) instants that no camera saw are bridged.
        stands: (S,) at which one that drives is known to stand: its speed is zero there (a zero-velocity update:
            Foxlin, "Pedestrian tracking with shoe-mounted inertial sensors", IEEE CG&A 2005), and between two such
            instants nothing moves.

    Returns:
        States (S, 5) of the model, with their covariances.
    """
    order = np.argsort(-lengths, kind="stable")
    start = (np.cumsum(lengths) - lengths)[order]
    going = np.searchsorted(-lengths[order], -np.arange(lengths.max()))  # how many are longer than so many instants
    states = _States(model.where(order), accelerations_mps2[order], times_ns, views, stands)
    states.begin(start, first.where(order))
    for k, count in enumerate(going[1:], 1):
        states.advance(start[:count] + k)
    for k in range(len(going) - 1, 0, -1):
        states.look_back(start[: going[k]] + k)
    return Belief(states.mean[:, :STATES], states.covariance[:, :STATES, :STATES])


class _States:
    """Of K road users at S instants: the motion (5), the acceleration, and the lasting errors of C cameras (3 each),
    these in standard deviations of what lasts. Rows are always instants of the first of the K, each its own."""

    def __init__(
        self,
        model: MotionModel,
        accelerations_mps2: Array,
        times_ns: Indices,
        views: Views,
        stands: NDArray[np.bool_],
    ) -> None:
        self._model, self._times_ns, self._views, self._stands = model, times_ns, views, stands
        self._variances = accelerations_mps2**2
        size = _MOTION + 3 * views.seen.shape[1]
        self._errors = np.arange(_MOTION, size)
        self.mean, self.covariance = np.zeros((len(times_ns), size)), np.zeros((len(times_ns), size, size))
        #: What was expected of each instant, before its own measurements, and how the one before follows from it.
        self._expected, self._spread = np.zeros_like(self.mean), np.zeros_like(self.covariance)
        self._back = np.zeros_like(self.covariance)

    def begin(self, rows: Indices, first: Measurement) -> None:
        """At the first instants of all."""
        belief = self._model.first_belief(Measurement(first.value, first.sd * _FIRST_DOUBT))
        self.mean[rows, :STATES], self.covariance[rows, :STATES, :STATES] = belief.mean, belief.covariance
        self.covariance[rows, _ACCELERATION, _ACCELERATION] = self._variances
        self.covariance[rows[:, None], self._errors, self._errors] = 1.0
        self._measure(rows)

    def advance(self, rows: Indices) -> None:
        """To these instants, each directly after one that is known."""
        count, before = len(rows), rows - 1
        model, dt_s = self._model.where(slice(count)), (self._times_ns[rows] - self._times_ns[before]) * 1e-9
        mean, step = self.mean[before].copy(), np.zeros((count, *self.covariance.shape[1:]))
        # on the way, the speed is that of its middle
        drives = ~model.turns_freely
        half = np.where(drives, 0.5 * mean[:, _ACCELERATION] * dt_s, 0.0)
        mean[:, _SPEED] += half
        moved, jacobian = model.predict(Belief(mean[:, :STATES], np.zeros((count, STATES, STATES))), dt_s)
        by_acceleration = jacobian[:, :, _SPEED] * (0.5 * dt_s)[:, None]
        by_acceleration[:, _SPEED] = dt_s
        by_acceleration[~drives] = 0.0
        mean[:, :STATES], noise = moved.mean, moved.covariance
        mean[:, _SPEED] += half
        still = self._stands[rows] & self._stands[before]
        mean[still, :STATES] = self.mean[before[still], :STATES]
        jacobian[still], noise[still], by_acceleration[still] = np.eye(STATES), 0.0, 0.0

        keep, errors = np.exp(-dt_s / _ACCELERATING_S), self._errors
        fades = np.exp(-dt_s / _LASTING_S)
        mean[:, _ACCELERATION] *= keep
        mean[:, _MOTION:] *= fades[:, None]
        step[:, :STATES, :STATES], step[:, :STATES, _ACCELERATION] = jacobian, by_acceleration
        step[:, _ACCELERATION, _ACCELERATION], step[:, errors, errors] = keep, fades[:, None]
        moving = step @ self.covariance[before]
        covariance = moving @ transposed(step)
        covariance[:, :STATES, :STATES] += noise
        covariance[:, _ACCELERATION, _ACCELERATION] += (1 - keep**2) * self._variances[:count]
        covariance[:, errors, errors] += (1 - fades**2)[:, None]
        self.mean[rows], self.covariance[rows] = mean, covariance
        self._expected[rows], self._spread[rows] = mean, covariance
        self._back[rows] = self._gain(covariance, moving)
        self._measure(rows)

    def look_back(self, rows: Indices) -> None:
        """From these instants, of which all is known, to those directly before."""
        before, back = rows - 1, self._back[rows]
        difference = self.mean[rows] - self._expected[rows]
        difference[:, YAW] = normalise_angle(difference[:, YAW])
        mean = self.mean[before] + times(back, difference)
        mean[:, YAW] = normalise_angle(mean[:, YAW])
        covariance = self.covariance[before] + back @ (self.covariance[rows] - self._spread[rows]) @ transposed(back)
        self.mean[before], self.covariance[before] = mean, 0.5 * (covariance + transposed(covariance))

    def _gain(self, covariance: Array, moving: Array) -> Array:
        """What of a difference at the later instant there was at the one before; whoever has no acceleration has no
        variance of it."""
        certain = np.flatnonzero(covariance[:, _ACCELERATION, _ACCELERATION] == 0.0)
        solvable = covariance.copy()
        solvable[certain, _ACCELERATION, _ACCELERATION] = 1.0
        return transposed(np.asarray(np.linalg.solve(solvable, moving), np.float64))

    def _measure(self, rows: Indices) -> None:
        """Take in what each camera saw at these instants, and who stands."""
        for camera in range(self._views.seen.shape[1]):
            who = np.flatnonzero(self._views.seen[rows, camera])
            if len(who):
                self._see(rows[who], self._model.where(who), camera)
        halted = rows[self._stands[rows]]
        if len(halted):
            H = np.zeros((len(halted), 1, self.mean.shape[1]))
            H[:, :, _SPEED] = 1.0
            speed, variance = self.mean[halted, _SPEED, None], self.covariance[halted, _SPEED, _SPEED]
            self._take_in(halted, -speed, (variance + _HALTED_SD_MPS**2)[:, None, None], H)

    def _see(self, rows: Indices, model: MotionModel, camera: int) -> None:
        mean, covariance = self.mean[rows], self.covariance[rows]
        sd = self._views.sd[rows, camera]
        centre, jacobian = model.centre(mean[:, :STATES])
        first, lasting = _MOTION + 3 * camera, np.sqrt(_LASTING_SHARE) * sd
        H = np.zeros((len(rows), 3, mean.shape[1]))
        H[:, :, :STATES] = jacobian
        H[:, range(3), range(first, first + 3)] = lasting
        difference = self._views.values[rows, camera] - centre - lasting * mean[:, first : first + 3]
        difference[:, YAW] = 0.5 * normalise_angle(2.0 * difference[:, YAW])
        S = H @ covariance @ transposed(H) + diagonal((1.0 - _LASTING_SHARE) * sd**2)
        self._take_in(rows, difference, loosened(difference, S, sd), H)
        self.mean[rows, :STATES] = model.bounded(self.mean[rows, :STATES])

    def _take_in(self, rows: Indices, difference: Array, S: Array, H: Array) -> None:
        """Measured minus expected (N, m), its covariance (N, m, m), and the Jacobian (N, m, states)."""
        covariance = self.covariance[rows]
        gain = transposed(np.asarray(np.linalg.solve(S, H @ covariance), np.float64))
        mean = self.mean[rows] + times(gain, difference)
        mean[:, YAW] = normalise_angle(mean[:, YAW])
        covariance = covariance - gain @ S @ transposed(gain)
        self.mean[rows], self.covariance[rows] = mean, 0.5 * (covariance + transposed(covariance))
