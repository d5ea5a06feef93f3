"""Motion on foot: a velocity that bends to any side at once, and a yaw of its own.

State: x, y of the centre (m), yaw (rad), velocity along world X and Y (m/s). People walk where they look, but they also
stand and turn, and step aside: the yaw follows what is seen of it, and only its front is told by where they go.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
from wibam_core.traits import Walking

VX, VY = 3, 4
_VELOCITY = [VX, VY]
_DIAGONAL = np.arange(STATES)


@dataclass(frozen=True, eq=False)
class WalkingModel:
    """A `MotionModel` of one pedestrian, or of many: all attributes are numbers of each (...), see `Walking`.

    Attributes:
        drift: (..., 5) standard deviation of the state per √s.
        first_sd: (..., 2) of the velocity of one that was seen once.
    """

    acceleration_mps2: Array
    drift: Array
    first_sd: Array

    @classmethod
    def of(cls, motions: Sequence[Walking]) -> WalkingModel:
        """Of pedestrians (N,)."""
        return cls(
            acceleration_mps2=np.array([m.acceleration_mps2 for m in motions]),
            drift=np.array([[m.position_drift_m, m.position_drift_m, m.yaw_drift_rad, 0.0, 0.0] for m in motions]),
            first_sd=np.array([[m.first_speed_sd_mps, m.first_speed_sd_mps] for m in motions]),
        )

    @property
    def turns_freely(self) -> NDArray[np.bool_]:
        return np.ones(self.acceleration_mps2.shape, dtype=bool)

    def where(self, rows: Rows) -> WalkingModel:
        return WalkingModel(*(getattr(self, field.name)[rows] for field in fields(self)))

    def first_belief(self, measurement: Measurement) -> Belief:
        mean = np.concatenate([measurement.value, np.zeros_like(self.first_sd)], axis=-1)
        return Belief(mean, diagonal(np.concatenate([measurement.sd, self.first_sd], axis=-1) ** 2))

    def predict(self, belief: Belief, dt_s: ArrayLike) -> tuple[Belief, Array]:
        dt = np.asarray(dt_s, dtype=np.float64)
        F = np.zeros((*belief.mean.shape, STATES))
        F[..., _DIAGONAL, _DIAGONAL] = 1.0
        F[..., X, VX] = F[..., Y, VY] = dt
        mean = belief.mean.copy()
        mean[..., :YAW] += belief.mean[..., _VELOCITY] * dt[..., None]
        return Belief(mean, F @ belief.covariance @ transposed(F) + self._process_noise(np.abs(dt))), F

    def _process_noise(self, dt_s: Array) -> Array:
        noise = diagonal(self.drift**2 * dt_s[..., None])
        variance = self.acceleration_mps2**2
        for place, speed in ((X, VX), (Y, VY)):
            noise[..., place, place] += 0.25 * variance * dt_s**4
            noise[..., speed, speed] += variance * dt_s**2
            noise[..., place, speed] = noise[..., speed, place] = 0.5 * variance * dt_s**3
        return noise

    def centre(self, mean: Array) -> tuple[Array, Array]:
        H = np.zeros((*mean.shape[:-1], 3, STATES))
        H[..., X, X] = H[..., Y, Y] = H[..., YAW, YAW] = 1.0
        return mean[..., : YAW + 1].copy(), H

    def bounded(self, mean: Array) -> Array:
        return mean

    def halted(self, belief: Belief) -> Belief:
        return without_speed(belief, _VELOCITY)

    def velocity(self, mean: Array) -> tuple[Array, Array]:
        return mean[..., _VELOCITY], np.zeros(mean.shape[:-1])

    def travel(self, mean: Array) -> tuple[Array, Array]:
        yaw = mean[..., YAW]
        return mean[..., _VELOCITY], mean[..., VX] * np.cos(yaw) + mean[..., VY] * np.sin(yaw)

    def speed_sd(self, belief: Belief) -> Array:
        variances = np.maximum(belief.covariance[..., VX, VX], belief.covariance[..., VY, VY])
        return np.asarray(np.sqrt(variances))
