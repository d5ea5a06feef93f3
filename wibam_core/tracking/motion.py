"""Motion of a vehicle with a fixed rear axle: kinematic bicycle model, extended Kalman filter and smoother.

State: x, y of the rear axle's middle (m), yaw (rad), speed (m/s, negative in reverse), curvature of its path (1/m).
The yaw changes by speed · curvature, so that a vehicle at rest cannot spin and one that drives follows its heading;
the geometric centre, which is what is measured, swings out in a turn as a real vehicle's does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.se3 import normalise_angle

Array = NDArray[np.float64]

X, Y, YAW, SPEED, CURVATURE = range(5)

#: The rear axle lies this share of the length behind the centre.
AXLE_SHARE = 0.27

#: Process noise: acceleration (m/s²), drift of the curvature (1/m per √s), of the yaw (rad per √s) and of the
#: position (m per √s).
_ACCELERATION = 2.0
_CURVATURE_DRIFT = 0.06
_YAW_DRIFT = 0.02
_POSITION_DRIFT = 0.05
#: Curvatures are pulled back to straight with this time constant (s), and lie below the tightest turn (1/m).
_STRAIGHTENING_S = 2.0
_MAX_CURVATURE = 0.25
#: First guess of a new vehicle.
_FIRST_SPEED_SD = 8.0
_FIRST_CURVATURE_SD = 0.05
#: Innovations beyond this squared Mahalanobis distance (95 % of χ² with 3 degrees of freedom) are trusted less.
_OUTLIER = 7.81


@dataclass(frozen=True, eq=False)
class Belief:
    """State (5,) and its covariance (5, 5)."""

    mean: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Measurement:
    """A vehicle's centre and yaw (3,) with standard deviations (3,), m and rad; the yaw is known up to half a turn."""

    time_ns: int
    value: Array
    sd: Array


def first_belief(measurement: Measurement, axle_m: float) -> Belief:
    """Of a vehicle seen once. ``axle_m``: from the rear axle to the centre."""
    x, y, yaw = measurement.value
    mean = np.array([x - axle_m * np.cos(yaw), y - axle_m * np.sin(yaw), yaw, 0.0, 0.0])
    sd = [*np.hypot(measurement.sd[:2], axle_m * measurement.sd[2]), measurement.sd[2]]
    return Belief(mean, np.diag([*sd, _FIRST_SPEED_SD, _FIRST_CURVATURE_SD]) ** 2)


def predict(belief: Belief, dt_s: float) -> tuple[Belief, Array]:
    """The belief ``dt_s`` later (any sign), and the Jacobian (5, 5) of the step."""
    x, y, yaw, speed, curvature = belief.mean
    turn = speed * curvature * dt_s
    middle = yaw + 0.5 * turn
    chord = speed * dt_s
    c, s = np.cos(middle), np.sin(middle)
    keep = float(np.exp(-abs(dt_s) / _STRAIGHTENING_S))
    mean = np.array([x + chord * c, y + chord * s, normalise_angle(yaw + turn), speed, curvature * keep])
    F = np.eye(5)
    F[X, YAW], F[Y, YAW] = -chord * s, chord * c
    half = 0.5 * chord * dt_s
    F[X, SPEED], F[Y, SPEED] = dt_s * c - half * curvature * s, dt_s * s + half * curvature * c
    F[X, CURVATURE], F[Y, CURVATURE] = -half * speed * s, half * speed * c
    F[YAW, SPEED], F[YAW, CURVATURE] = curvature * dt_s, chord
    F[CURVATURE, CURVATURE] = keep
    return Belief(mean, F @ belief.covariance @ F.T + _process_noise(yaw, abs(dt_s))), F


def _process_noise(yaw: float, dt_s: float) -> Array:
    along = np.array([np.cos(yaw), np.sin(yaw), 0.0, 0.0, 0.0]) * 0.5 * dt_s**2
    along[SPEED] = dt_s
    noise = _ACCELERATION**2 * np.outer(along, along)
    drift = np.array([_POSITION_DRIFT, _POSITION_DRIFT, _YAW_DRIFT, 0.0, _CURVATURE_DRIFT])
    return noise + np.diag(drift**2) * dt_s


def centre(belief: Belief, axle_m: float) -> tuple[Array, Array]:
    """Centre and yaw (3,) that would be measured, and the Jacobian (3, 5)."""
    x, y, yaw = belief.mean[:3]
    c, s = np.cos(yaw), np.sin(yaw)
    H = np.zeros((3, 5))
    H[0, X] = H[1, Y] = H[2, YAW] = 1.0
    H[0, YAW], H[1, YAW] = -axle_m * s, axle_m * c
    return np.array([x + axle_m * c, y + axle_m * s, yaw]), H


def innovation(belief: Belief, measurement: Measurement, axle_m: float) -> tuple[Array, Array, Array]:
    """Measured minus expected (3,), its covariance (3, 3), and the Jacobian (3, 5). The yaw's lies within ±π/2."""
    expected, H = centre(belief, axle_m)
    difference = measurement.value - expected
    difference[2] = half_turn(difference[2])
    return difference, H @ belief.covariance @ H.T + np.diag(measurement.sd**2), H


def half_turn(angle_rad: float) -> float:
    """An angle between axes without a direction, in (−π/2, π/2]."""
    return float(0.5 * normalise_angle(2.0 * angle_rad))


def update(belief: Belief, measurement: Measurement, axle_m: float) -> Belief:
    """The belief after a measurement; one that lies far off is given less weight."""
    difference, S, H = innovation(belief, measurement, axle_m)
    distance = float(difference @ np.linalg.solve(S, difference))
    if distance > _OUTLIER:
        S = S + np.diag(measurement.sd**2) * (distance / _OUTLIER - 1.0)
    gain = np.linalg.solve(S, H @ belief.covariance).T
    mean = belief.mean + gain @ difference
    mean[YAW] = normalise_angle(mean[YAW])
    mean[CURVATURE] = np.clip(mean[CURVATURE], -_MAX_CURVATURE, _MAX_CURVATURE)
    covariance = belief.covariance - gain @ S @ gain.T
    return Belief(mean, 0.5 * (covariance + covariance.T))
