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

    def where(self, rows: NDArray[np.bool_]) -> TurningStates:
        """Those of the selected moments (K,)."""
        return TurningStates(self.boxes[rows], self.velocities[rows], self.yaw_rates[rows])

    def after(self, seconds: float) -> Array:
        """Boxes (K, 7) later, on arcs of constant speed and yaw rate."""
        turn = self.yaw_rates * seconds
        # The chord of an arc: turned by half of the whole turn, and shorter than the arc by sin(x)/x.
        chord = seconds * np.sinc(turn / (2 * np.pi))
        c, s = np.cos(turn / 2), np.sin(turn / 2)
        vx, vy = self.velocities.T
        boxes = self.boxes.copy()
        boxes[:, X] += chord * (c * vx - s * vy)
        boxes[:, Y] += chord * (s * vx + c * vy)
        boxes[:, YAW] += turn
        return boxes


def collide_turning(a: TurningStates, b: TurningStates, horizon_s: float) -> NDArray[np.bool_]:
    """(K,) whether the footprints touch within ``horizon_s``, looked at every 0.1 s."""
    hit = np.zeros(len(a.boxes), dtype=bool)
    open_rows = np.arange(len(hit))
    for step in range(1, int(np.ceil(horizon_s / _STEP_S)) + 1):
        seconds = min(step * _STEP_S, horizon_s)
        touch = footprints_touch(a.after(seconds), b.after(seconds))
        if touch.any():
            hit[open_rows[touch]] = True
            a, b, open_rows = a.where(~touch), b.where(~touch), open_rows[~touch]
            if not len(open_rows):
                break
    return hit
