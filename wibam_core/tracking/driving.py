"""Motion on wheels with a fixed rear axle: the kinematic bicycle model.

State: x, y of the rear axle's middle (m), yaw (rad), speed (m/s, negative in reverse), curvature of its path (1/m).
The yaw changes by speed · curvature, so that one at rest cannot spin and one that drives follows its heading; the
geometric centre, which is what is measured, swings out in a turn as a real vehicle's does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.geometry.se3 import normalise_angle
from wibam_core.tracking.motion import (
    STATES,
    YAW,
    Array,
    Belief,
    Measurement,
    Rows,
    X,
    Y,
    diagonal,
    transposed,
    without_speed,
)
from wibam_core.traits import Driving

SPEED, CURVATURE = 3, 4
_DIAGONAL = np.arange(STATES)


@dataclass(frozen=True, eq=False)
class DrivingModel:
    """A `MotionModel` of one vehicle, or of many: all attributes are numbers of each (...), see `Driving`.

    Attributes:
        axle_m: from the rear axle to the centre.
        drift: (..., 5) standard deviation of the state per √s.
        first_sd: (..., 2) of the speed and the curvature of one that was seen once.
    """

    axle_m: Array
    acceleration_mps2: Array
    straightening_s: Array
    max_curvature: Array
    drift: Array
    first_sd: Array

    @classmethod
    def of_unit_length(cls, motions: Sequence[Driving]) -> DrivingModel:
        """Of vehicles (N,) that are 1 m long each."""
        return cls(
            axle_m=np.array([m.axle_share for m in motions]),
            acceleration_mps2=np.array([m.acceleration_mps2 for m in motions]),
            straightening_s=np.array([m.straightening_s for m in motions]),
            max_curvature=np.array([m.max_curvature for m in motions]),
            drift=np.array(
                [[m.position_drift_m, m.position_drift_m, m.yaw_drift_rad, 0.0, m.curvature_drift] for m in motions]
            ),
            first_sd=np.array([[m.first_speed_sd_mps, m.first_curvature_sd] for m in motions]),
        )

    @property
    def turns_freely(self) -> NDArray[np.bool_]:
        return np.zeros(self.axle_m.shape, dtype=bool)

    def where(self, rows: Rows) -> DrivingModel:
        return DrivingModel(*(getattr(self, field.name)[rows] for field in fields(self)))

    def first_belief(self, measurement: Measurement) -> Belief:
        yaw, axle_m = measurement.value[..., YAW], self.axle_m
        mean = np.zeros((*yaw.shape, STATES))
        mean[..., X] = measurement.value[..., X] - axle_m * np.cos(yaw)
        mean[..., Y] = measurement.value[..., Y] - axle_m * np.sin(yaw)
        mean[..., YAW] = yaw
        yaw_sd = measurement.sd[..., YAW, None]
        place_sd = np.hypot(measurement.sd[..., :YAW], axle_m[..., None] * yaw_sd)
        return Belief(mean, diagonal(np.concatenate([place_sd, yaw_sd, self.first_sd], axis=-1) ** 2))

    def predict(self, belief: Belief, dt_s: ArrayLike) -> tuple[Belief, Array]:
        dt = np.asarray(dt_s, dtype=np.float64)
        x, y, yaw, speed, curvature = np.moveaxis(belief.mean, -1, 0)
        turn = speed * curvature * dt
        middle = yaw + 0.5 * turn
        chord = speed * dt
        c, s = np.cos(middle), np.sin(middle)
        keep = np.exp(-np.abs(dt) / self.straightening_s)
        mean = np.stack([x + chord * c, y + chord * s, normalise_angle(yaw + turn), speed, curvature * keep], axis=-1)
        F = np.zeros((*mean.shape, STATES))
        F[..., _DIAGONAL, _DIAGONAL] = 1.0
        F[..., X, YAW], F[..., Y, YAW] = -chord * s, chord * c
        half = 0.5 * chord * dt
        F[..., X, SPEED], F[..., Y, SPEED] = dt * c - half * curvature * s, dt * s + half * curvature * c
        F[..., X, CURVATURE], F[..., Y, CURVATURE] = -half * speed * s, half * speed * c
        F[..., YAW, SPEED], F[..., YAW, CURVATURE] = curvature * dt, chord
        F[..., CURVATURE, CURVATURE] = keep
        return Belief(mean, F @ belief.covariance @ transposed(F) + self._process_noise(yaw, np.abs(dt))), F

    def _process_noise(self, yaw: Array, dt_s: Array) -> Array:
        along = np.zeros((*yaw.shape, STATES))
        along[..., X], along[..., Y] = np.cos(yaw) * 0.5 * dt_s**2, np.sin(yaw) * 0.5 * dt_s**2
        along[..., SPEED] = dt_s
        noise = self.acceleration_mps2[..., None, None] ** 2 * (along[..., :, None] * along[..., None, :])
        noise[..., _DIAGONAL, _DIAGONAL] += self.drift**2 * dt_s[..., None]
        return noise

    def centre(self, mean: Array) -> tuple[Array, Array]:
        yaw = mean[..., YAW]
        ahead, aside = self.axle_m * np.cos(yaw), self.axle_m * np.sin(yaw)
        H = np.zeros((*yaw.shape, 3, STATES))
        H[..., X, X] = H[..., Y, Y] = H[..., YAW, YAW] = 1.0
        H[..., X, YAW], H[..., Y, YAW] = -aside, ahead
        return np.stack([mean[..., X] + ahead, mean[..., Y] + aside, yaw], axis=-1), H

    def bounded(self, mean: Array) -> Array:
        bounded = mean.copy()
        bounded[..., CURVATURE] = np.clip(mean[..., CURVATURE], -self.max_curvature, self.max_curvature)
        return bounded

    def halted(self, belief: Belief) -> Belief:
        return without_speed(belief, [SPEED])

    def velocity(self, mean: Array) -> tuple[Array, Array]:
        yaw, speed = mean[..., YAW], mean[..., SPEED]
        c, s = np.cos(yaw), np.sin(yaw)
        yaw_rate = speed * mean[..., CURVATURE]
        across = self.axle_m * yaw_rate
        return np.stack([speed * c - across * s, speed * s + across * c], axis=-1), yaw_rate

    def travel(self, mean: Array) -> tuple[Array, Array]:
        yaw, speed = mean[..., YAW], mean[..., SPEED]
        return np.stack([speed * np.cos(yaw), speed * np.sin(yaw)], axis=-1), speed

    def speed_sd(self, belief: Belief) -> Array:
        return np.sqrt(belief.covariance[..., SPEED, SPEED])
