"""Drivers: how one vehicle accelerates and brakes.

Intelligent driver model: Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and
microscopic simulations", Phys. Rev. E 62, 2000, eq. 1–3.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wibam_core.road_users import RoadUserClass
from wibam_core.synthetic.routes import Route
from wibam_core.synthetic.vehicles import VehicleModel

Array = NDArray[np.float64]

#: Time between two states of a simulation.
STEP_S = 0.04
EMERGENCY_MPS2 = 7.0
_LATERAL_MPS2 = 2.2
_COMFORT_MPS2 = 2.2
_JAM_GAP_M = 2.0
#: Who looks away brakes once this much is needed to stop so far behind the one ahead.
_LATE_BRAKING_MPS2 = 5.0
_LATE_GAP_M = 1.2


@dataclass(eq=False)
class Driver:
    """A vehicle while it is being simulated.

    Attributes:
        route: number of its route. s, v: middle of the vehicle along the route (m), and speed (m/s).
        speed_factor: how it takes speed limits. headway_s: time gap it keeps.
        margin_s: how much later than itself another vehicle must arrive for it to go first.
        history_s, history_v: states at every step since ``first_step``.
        waited_s: how long it has been standing. committed: it decided to pass an amber light.
        looks_away: it sees late that the one ahead is slower. braking_late: it has just seen it.
        runs_red: it passes a light that has just turned red.
        impatient: it does not wait until the middle is clear.
    """

    vehicle_id: int
    model: VehicleModel
    route: int
    s: float
    v: float
    speed_factor: float
    headway_s: float
    margin_s: float
    first_step: int
    history_s: list[float] = field(default_factory=list)
    history_v: list[float] = field(default_factory=list)
    waited_s: float = 0.0
    committed: bool = False
    looks_away: bool = False
    braking_late: bool = False
    runs_red: bool = False
    impatient: bool = False

    @property
    def front(self) -> float:
        return self.s + self.model.length_m / 2

    @property
    def rear(self) -> float:
        return self.s - self.model.length_m / 2


def time_to_cover(distance_m: float, speed_mps: float) -> float:
    """Time to cover a distance when accelerating at 1.8 m/s² up to 8 m/s."""
    if distance_m <= 0:
        return 0.0
    a, top = 1.8, max(8.0, speed_mps)
    gain = (top**2 - speed_mps**2) / (2 * a)
    if distance_m <= gain:
        return float((np.sqrt(speed_mps**2 + 2 * a * distance_m) - speed_mps) / a)
    return float((top - speed_mps) / a + (distance_m - gain) / top)


def _top_acceleration(driver: Driver) -> float:
    return 1.8 if driver.model.vehicle_class in (RoadUserClass.CAR, RoadUserClass.VAN) else 1.2


def free_acceleration(driver: Driver, limit_mps: float) -> float:
    """Acceleration on an empty road (IDM), braking gently above the limit."""
    if driver.v > limit_mps:
        return -min(3.0, 2.0 * (driver.v - limit_mps))
    return float(_top_acceleration(driver) * (1 - (driver.v / max(limit_mps, 0.1)) ** 4))


def follow(driver: Driver, limit_mps: float, gap_m: float, leader_mps: float) -> float:
    """Acceleration behind a leader (IDM)."""
    top, v = _top_acceleration(driver), driver.v
    closing = v * (v - leader_mps) / (2 * np.sqrt(top * _COMFORT_MPS2))
    desired = _JAM_GAP_M + max(0.0, v * driver.headway_s + closing)
    interaction = top * (desired / max(gap_m, 0.05)) ** 2
    return float(max(-EMERGENCY_MPS2, free_acceleration(driver, limit_mps) - interaction))


def notices(driver: Driver, gap_m: float, leader_mps: float) -> bool:
    """Whether a driver reacts to the one ahead: who looks away does so once only hard braking is left."""
    closing = driver.v - leader_mps
    if not driver.looks_away or gap_m < _LATE_GAP_M:
        return True
    if closing < 0.3:
        driver.braking_late = False
        return False
    needed = closing**2 / (2 * (gap_m - _LATE_GAP_M + 0.05))
    driver.braking_late = driver.braking_late or needed > _LATE_BRAKING_MPS2
    return driver.braking_late


def stop_within(driver: Driver, gap_m: float) -> float:
    """Upper bound of the acceleration for a stop within the gap: brakes no earlier than comfort asks for."""
    gap = gap_m - 0.4
    if gap < 0.15:
        return -min(_COMFORT_MPS2 if driver.v < 1.2 else EMERGENCY_MPS2, driver.v / STEP_S)
    needed = driver.v**2 / (2 * gap)
    return -min(EMERGENCY_MPS2, needed) if needed > 1.5 else np.inf


def move(driver: Driver, acceleration: float) -> None:
    """One step in time; a vehicle never rolls back."""
    v = driver.v + acceleration * STEP_S
    if v < 0:
        stopping = driver.v**2 / (2 * max(-acceleration, 1e-6))
        driver.s, driver.v = driver.s + stopping, 0.0
    else:
        driver.s += 0.5 * (driver.v + v) * STEP_S
        driver.v = v
    driver.waited_s = driver.waited_s + STEP_S if driver.v < 0.2 else 0.0


def speed_limits(route: Route, speed_mps: float) -> Array:
    """(M,) speed at every half metre: bounded by lateral acceleration in curves, and by braking before them."""
    s = np.arange(0.0, route.length_m, 0.5)
    curvature = np.abs(np.interp(s, route.s_m, route.curvature))
    smooth = np.convolve(np.pad(curvature, 3, mode="edge"), np.ones(7) / 7, mode="valid")
    limits = np.minimum(speed_mps, np.sqrt(_LATERAL_MPS2 / np.maximum(smooth, 1e-4)))
    for i in range(len(limits) - 2, -1, -1):
        limits[i] = min(limits[i], np.sqrt(limits[i + 1] ** 2 + 2 * 1.6 * 0.5))
    return np.asarray(limits)
