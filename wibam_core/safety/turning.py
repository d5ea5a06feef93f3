"""Whether two road users collide if both keep their speed and go on turning as they do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import YAW, X, Y
from wibam_core.safety.ttc import footprints_touch

Array = NDArray[np.float64]

#: At 20 m/s relative speed two cars move 2 m, half a length, in one step.
_STEP_S = 0.1


@dataclass(frozen=True, eq=False)
class TurningStates:
    """Footprints (K, 7), velocities (K, 2) in m/s and yaw rates (K,) in rad/s of one road user at K moments."""

    boxes: Array
    velocities: Array
    yaw_rates: Array

    def where(self, rows: NDArray[np.int64]) -> TurningStates:
        """Those of the selected moments."""
        return TurningStates(self.boxes[rows], self.velocities[rows], self.yaw_rates[rows])

    def after(self, seconds: float | Array) -> Array:
        """Boxes (..., K, 7) later, on arcs of constant speed and yaw rate; of times (..., 1) or (K,) those at each."""
        half = 0.5 * self.yaw_rates * seconds
        c, s = np.cos(half), np.sin(half)
        # The chord of an arc: turned by half of the whole turn, and shorter than the arc by sin(x)/x.
        chord = seconds * np.divide(s, half, out=np.ones_like(half), where=half != 0)
        vx, vy = self.velocities.T
        boxes = np.broadcast_to(self.boxes, (*half.shape, self.boxes.shape[-1])).copy()
        boxes[..., X] += chord * (c * vx - s * vy)
        boxes[..., Y] += chord * (s * vx + c * vy)
        boxes[..., YAW] += 2 * half
        return boxes


def collide_turning(a: TurningStates, b: TurningStates, horizon_s: float, likely_s: Array) -> NDArray[np.bool_]:
    """(K,) whether the footprints touch within ``horizon_s``, looked at every 0.1 s.

    Args:
        a: one of the two.
        b: the other.
        horizon_s: how far ahead.
        likely_s: (K,) when they would touch straight on: looked at first, since most that turn touch then, too.
    """
    steps = np.minimum(np.arange(1, int(np.ceil(horizon_s / _STEP_S)) + 1) * _STEP_S, horizon_s)
    first = np.clip(np.ceil(likely_s / _STEP_S).astype(np.int64), 0, len(steps) - 1)
    hit = footprints_touch(a.after(steps[first]), b.after(steps[first]))
    rest = np.flatnonzero(~hit)
    if len(rest):
        a, b = a.where(rest), b.where(rest)
        hit[rest] = footprints_touch(a.after(steps[:, None]), b.after(steps[:, None])).any(axis=0)
    return hit
