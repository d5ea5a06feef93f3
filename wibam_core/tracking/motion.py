"""Beliefs about how road users move: what every model of motion can do, and the extended Kalman filter over any.

A model's state has five numbers, of which the first three are a place x, y (m) and a yaw (rad); the other two say how
these change. All is for one road user or for many at once, each for itself: leading dimensions (...) are theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.geometry.se3 import normalise_angle

Array = NDArray[np.float64]
#: Which of many: their numbers, a mask, or the first of them.
Rows = NDArray[np.int64] | NDArray[np.bool_] | slice

X, Y, YAW = range(3)
STATES = 5

#: Innovations beyond this squared Mahalanobis distance (95 % of χ² with 3 degrees of freedom) are trusted less.
_OUTLIER = 7.81
#: Standard deviation of the speed of somebody who is seen to stand, m/s.
_HALTED_SD_MPS = 0.05


@dataclass(frozen=True, eq=False)
class Belief:
    """State (..., 5) and its covariance (..., 5, 5)."""

    mean: Array
    covariance: Array

    def where(self, rows: Rows) -> Belief:
        """Those of the selected road users."""
        return Belief(self.mean[rows], self.covariance[rows])


@dataclass(frozen=True, eq=False)
class Measurement:
    """A centre and yaw (..., 3) with standard deviations (..., 3), m and rad; the yaw is known up to half a turn."""

    value: Array
    sd: Array

    def where(self, rows: Rows) -> Measurement:
        """Those of the selected road users."""
        return Measurement(self.value[rows], self.sd[rows])


class MotionModel(Protocol):
    """How road users move. A model knows the size of each that it is of.

    Attributes:
        turns_freely: (...) whether its yaw and the way that it goes are two things, and only its front follows the way.
    """

    @property
    def turns_freely(self) -> NDArray[np.bool_]: ...

    def where(self, rows: Rows) -> Self:
        """The model of the selected ones."""
        ...

    def first_belief(self, measurement: Measurement) -> Belief:
        """Of those that were seen once."""
        ...

    def predict(self, belief: Belief, dt_s: ArrayLike) -> tuple[Belief, Array]:
        """The belief ``dt_s`` (...) later (any sign), and the Jacobian (..., 5, 5) of the step."""
        ...

    def centre(self, mean: Array) -> tuple[Array, Array]:
        """Centre and yaw (..., 3) that would be measured, and the Jacobian (..., 3, 5)."""
        ...

    def bounded(self, mean: Array) -> Array:
        """The nearest state (..., 5) that can be."""
        ...

    def halted(self, belief: Belief) -> Belief:
        """What is believed of those of whom it is seen that they stand."""
        ...

    def velocity(self, mean: Array) -> tuple[Array, Array]:
        """Velocity (..., 2) of the centre, m/s, and yaw rate (...), rad/s."""
        ...

    def travel(self, mean: Array) -> tuple[Array, Array]:
        """Velocity (..., 2) of the place x, y of the state, m/s, and how much of it is along the yaw (...)."""
        ...

    def speed_sd(self, belief: Belief) -> Array:
        """Standard deviation (...) of the speed, m/s."""
        ...


def innovation(model: MotionModel, belief: Belief, measurement: Measurement) -> tuple[Array, Array, Array]:
    """Measured minus expected (..., 3), its covariance (..., 3, 3), and the Jacobian (..., 3, 5).

    The yaw's lies in (−π/2, π/2]: an axis has no direction.
    """
    expected, H = model.centre(belief.mean)
    difference = measurement.value - expected
    difference[..., YAW] = 0.5 * normalise_angle(2.0 * difference[..., YAW])
    return difference, H @ belief.covariance @ transposed(H) + diagonal(measurement.sd**2), H


def update(model: MotionModel, belief: Belief, measurement: Measurement) -> Belief:
    """The belief after a measurement; one that lies far off is given less weight."""
    difference, S, H = innovation(model, belief, measurement)
    beyond = np.maximum(squared_distance(difference, S) / _OUTLIER - 1.0, 0.0)
    S = S + diagonal(measurement.sd**2 * beyond[..., None])
    gain = transposed(np.asarray(np.linalg.solve(S, H @ belief.covariance), np.float64))
    mean = belief.mean + times(gain, difference)
    mean[..., YAW] = normalise_angle(mean[..., YAW])
    covariance = belief.covariance - gain @ S @ transposed(gain)
    return Belief(model.bounded(mean), 0.5 * (covariance + transposed(covariance)))


def without_speed(belief: Belief, speeds: Sequence[int]) -> Belief:
    """The belief once the states of these numbers are known to be zero, but for how exactly one sees that."""
    chosen = np.eye(STATES)[list(speeds)]
    S = chosen @ belief.covariance @ chosen.T + _HALTED_SD_MPS**2 * np.eye(len(chosen))
    gain = transposed(np.asarray(np.linalg.solve(S, chosen @ belief.covariance), np.float64))
    mean = belief.mean - times(gain, belief.mean[..., list(speeds)])
    mean[..., YAW] = normalise_angle(mean[..., YAW])
    covariance = belief.covariance - gain @ S @ transposed(gain)
    return Belief(mean, 0.5 * (covariance + transposed(covariance)))


def squared_distance(difference: Array, covariance: Array) -> Array:
    """Squared Mahalanobis distances (...) of differences (..., n) with covariances (..., n, n)."""
    return np.asarray((difference * np.linalg.solve(covariance, difference[..., None])[..., 0]).sum(axis=-1))


def transposed(matrices: Array) -> Array:
    """Each of matrices (..., n, m), transposed."""
    return matrices.swapaxes(-1, -2)


def times(matrices: Array, vectors: Array) -> Array:
    """(..., n): each of matrices (..., n, m) times the vector (..., m) that belongs to it."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def diagonal(values: Array) -> Array:
    """Matrices (..., n, n) with values (..., n) on the diagonal."""
    return np.asarray(values[..., None] * np.eye(values.shape[-1]))
