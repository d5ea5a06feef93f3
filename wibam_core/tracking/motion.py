"""Beliefs about how road users move: what every model of motion can do, and the extended Kalman filter over any.

A model's state has five numbers, of which the first three are a place x, y (m) and a yaw (rad); the other two say how
these change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.se3 import normalise_angle

Array = NDArray[np.float64]

X, Y, YAW = range(3)
STATES = 5

#: Innovations beyond this squared Mahalanobis distance (95 % of χ² with 3 degrees of freedom) are trusted less.
_OUTLIER = 7.81


@dataclass(frozen=True, eq=False)
class Belief:
    """State (5,) and its covariance (5, 5)."""

    mean: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Measurement:
    """A centre and yaw (3,) with standard deviations (3,), m and rad; the yaw is known up to half a turn."""

    time_ns: int
    value: Array
    sd: Array


class MotionModel(Protocol):
    """How one road user moves. A model knows the size of the one it is of."""

    def first_belief(self, measurement: Measurement) -> Belief:
        """Of one that was seen once."""
        ...

    def predict(self, belief: Belief, dt_s: float) -> tuple[Belief, Array]:
        """The belief ``dt_s`` later (any sign), and the Jacobian (5, 5) of the step."""
        ...

    def centre(self, belief: Belief) -> tuple[Array, Array]:
        """Centre and yaw (3,) that would be measured, and the Jacobian (3, 5)."""
        ...

    def bounded(self, mean: Array) -> Array:
        """The nearest state (5,) that can be."""
        ...

    def velocity(self, mean: Array) -> tuple[Array, float]:
        """Velocity (2,) of the centre, m/s, and yaw rate, rad/s."""
        ...

    def travel(self, mean: Array) -> tuple[Array, float]:
        """Velocity (2,) of the place x, y of the state, m/s, and how much of it is along the yaw."""
        ...

    def speed_sd(self, belief: Belief) -> float:
        """Standard deviation of the speed, m/s."""
        ...


def innovation(model: MotionModel, belief: Belief, measurement: Measurement) -> tuple[Array, Array, Array]:
    """Measured minus expected (3,), its covariance (3, 3), and the Jacobian (3, 5). The yaw's lies within ±π/2."""
    expected, H = model.centre(belief)
    difference = measurement.value - expected
    difference[YAW] = half_turn(difference[YAW])
    return difference, H @ belief.covariance @ H.T + np.diag(measurement.sd**2), H


def half_turn(angle_rad: float) -> float:
    """An angle between axes without a direction, in (−π/2, π/2]."""
    return float(0.5 * normalise_angle(2.0 * angle_rad))


def update(model: MotionModel, belief: Belief, measurement: Measurement) -> Belief:
    """The belief after a measurement; one that lies far off is given less weight."""
    difference, S, H = innovation(model, belief, measurement)
    distance = float(difference @ np.linalg.solve(S, difference))
    if distance > _OUTLIER:
        S = S + np.diag(measurement.sd**2) * (distance / _OUTLIER - 1.0)
    gain = np.linalg.solve(S, H @ belief.covariance).T
    mean = belief.mean + gain @ difference
    mean[YAW] = normalise_angle(mean[YAW])
    covariance = belief.covariance - gain @ S @ gain.T
    return Belief(model.bounded(mean), 0.5 * (covariance + covariance.T))
