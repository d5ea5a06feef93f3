"""Where vehicles were over time, and those that would have driven through each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.synthetic.driving import STEP_S
from wibam_core.synthetic.routes import Route, footprints_overlap
from wibam_core.synthetic.vehicles import VehicleModel

Array = NDArray[np.float64]

#: Overlaps are looked for once in so many steps.
_CHECK_STEPS = 5


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One vehicle's way: states at every `STEP_S` from ``first_step`` on.

    Attributes:
        vehicle_id: unique within the traffic.
        model: its looks and size.
        route: None for a parked vehicle, whose pose is ``parked`` (x, y, yaw).
        s_m, speed_mps: (T,) middle of the vehicle along the route, and speed.
    """

    vehicle_id: int
    model: VehicleModel
    route: Route | None
    first_step: int
    s_m: Array
    speed_mps: Array
    parked: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def box(self, time_s: float) -> Array | None:
        """(7,) box at a time, or None while it is not there. Positions between steps are cubic (Hermite)."""
        length, width, height = self.model.size_m
        if self.route is None:
            x, y, yaw = self.parked
        else:
            position = time_s / STEP_S - self.first_step
            if position < 0 or position > len(self.s_m) - 1:
                return None
            k = min(int(position), len(self.s_m) - 2)
            s = _hermite(self.s_m[k : k + 2], self.speed_mps[k : k + 2], position - k)
            x, y, yaw = self.route.poses(s, length)
        return np.array([x, y, height / 2, length, width, height, yaw])


def _hermite(s: Array, v: Array, u: float) -> float:
    h00, h10 = (1 + 2 * u) * (1 - u) ** 2, u * (1 - u) ** 2
    h01, h11 = u * u * (3 - 2 * u), u * u * (u - 1)
    return float(h00 * s[0] + h10 * STEP_S * v[0] + h01 * s[1] + h11 * STEP_S * v[1])


def without_overlaps(trajectories: Sequence[Trajectory]) -> list[Trajectory]:
    """The trajectories left when the later one of any two whose footprints overlap is left out."""
    present: dict[int, list[tuple[int, Array]]] = {}
    for number, t in enumerate(trajectories):
        if t.route is None:
            continue
        steps = np.arange(-t.first_step % _CHECK_STEPS, len(t.s_m), _CHECK_STEPS)
        poses = t.route.poses(t.s_m[steps], t.model.length_m)
        length, width, height = t.model.size_m
        for step, (x, y, yaw) in zip((steps + t.first_step).tolist(), poses.tolist(), strict=True):
            box = np.array([x, y, height / 2, length, width, height, yaw])
            present.setdefault(step, []).append((number, box))
    dropped: set[int] = set()
    for _, here in sorted(present.items()):
        left = [(number, box) for number, box in here if number not in dropped]
        if len(left) < 2:
            continue
        boxes = np.array([box for _, box in left])
        i, j = np.triu_indices(len(left), 1)
        for k in np.flatnonzero(footprints_overlap(boxes[i], boxes[j])).tolist():
            earlier, later = left[i[k]][0], left[j[k]][0]
            if earlier not in dropped:
                dropped.add(later)
    return [t for number, t in enumerate(trajectories) if number not in dropped]
