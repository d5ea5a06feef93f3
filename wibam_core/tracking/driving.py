"""Motion on wheels with a fixed rear axle: the kinematic bicycle model.

State: x, y of the rear axle's middle (m), yaw (rad), speed (m/s, negative in reverse), curvature of its path (1/m).
The yaw changes by speed · curvature, so that one at rest cannot spin and one that drives follows its heading; the
geometric centre, which is what is measured, swings out in a turn as a real vehicle's does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wibam_core.geometry.se3 import normalise_angle
from wibam_core.tracking.motion import STATES, YAW, Array, Belief, Measurement, X, Y
from wibam_core.traits import Driving

SPEED, CURVATURE = 3, 4


@dataclass(frozen=True)
class DrivingModel:
    """A `MotionModel` of one vehicle.

    Attributes:
        motion: of its class.
        length_m: its length.
    """

    motion: Driving
    length_m: float

    @property
    def axle_m(self) -> float:
        """From the rear axle to the centre."""
        return self.motion.axle_share * self.length_m

    def first_belief(self, measurement: Measurement) -> Belief:
        x, y, yaw = measurement.value
        axle_m = self.axle_m
        mean = np.array([x - axle_m * np.cos(yaw), y - axle_m * np.sin(yaw), yaw, 0.0, 0.0])
        sd = [*np.hypot(measurement.sd[:2], axle_m * measurement.sd[2]), measurement.sd[2]]
        return Belief(mean, np.diag([*sd, self.motion.first_speed_sd_mps, self.motion.first_curvature_sd]) ** 2)

    def predict(self, belief: Belief, dt_s: float) -> tuple[Belief, Array]:
        x, y, yaw, speed, curvature = belief.mean
        turn = speed * curvature * dt_s
        middle = yaw + 0.5 * turn
        chord = speed * dt_s
        c, s = np.cos(middle), np.sin(middle)
        keep = float(np.exp(-abs(dt_s) / self.motion.straightening_s))
        mean = np.array([x + chord * c, y + chord * s, normalise_angle(yaw + turn), speed, curvature * keep])
        F = np.eye(STATES)
        F[X, YAW], F[Y, YAW] = -chord * s, chord * c
        half = 0.5 * chord * dt_s
        F[X, SPEED], F[Y, SPEED] = dt_s * c - half * curvature * s, dt_s * s + half * curvature * c
        F[X, CURVATURE], F[Y, CURVATURE] = -half * speed * s, half * speed * c
        F[YAW, SPEED], F[YAW, CURVATURE] = curvature * dt_s, chord
        F[CURVATURE, CURVATURE] = keep
        return Belief(mean, F @ belief.covariance @ F.T + self._process_noise(yaw, abs(dt_s))), F

    def _process_noise(self, yaw: float, dt_s: float) -> Array:
        motion = self.motion
        along = np.array([np.cos(yaw), np.sin(yaw), 0.0, 0.0, 0.0]) * 0.5 * dt_s**2
        along[SPEED] = dt_s
        noise = motion.acceleration_mps2**2 * np.outer(along, along)
        place = motion.position_drift_m
        drift = np.array([place, place, motion.yaw_drift_rad, 0.0, motion.curvature_drift])
        return noise + np.diag(drift**2) * dt_s

    def centre(self, belief: Belief) -> tuple[Array, Array]:
        x, y, yaw = belief.mean[:3]
        c, s = np.cos(yaw), np.sin(yaw)
        axle_m = self.axle_m
        H = np.zeros((3, STATES))
        H[0, X] = H[1, Y] = H[2, YAW] = 1.0
        H[0, YAW], H[1, YAW] = -axle_m * s, axle_m * c
        return np.array([x + axle_m * c, y + axle_m * s, yaw]), H

    def bounded(self, mean: Array) -> Array:
        most = self.motion.max_curvature
        return np.array([*mean[:CURVATURE], np.clip(mean[CURVATURE], -most, most)])

    def velocity(self, mean: Array) -> tuple[Array, float]:
        yaw, speed, curvature = mean[YAW], mean[SPEED], mean[CURVATURE]
        c, s = np.cos(yaw), np.sin(yaw)
        yaw_rate = speed * curvature
        across = self.axle_m * yaw_rate
        return np.array([speed * c - across * s, speed * s + across * c]), float(yaw_rate)

    def travel(self, mean: Array) -> tuple[Array, float]:
        speed = float(mean[SPEED])
        return speed * np.array([np.cos(mean[YAW]), np.sin(mean[YAW])]), speed

    def speed_sd(self, belief: Belief) -> float:
        return float(np.sqrt(belief.covariance[SPEED, SPEED]))
