"""Traffic: car-following along routes, signals, and yielding where routes meet.

Turning traffic yields by gap acceptance; drivers differ in the gaps they accept, so some left turns are tight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.road_users import RoadUserClass
from wibam_core.synthetic.conflicts import Zone, find_zones
from wibam_core.synthetic.driving import (
    EMERGENCY_MPS2,
    STEP_S,
    Driver,
    follow,
    free_acceleration,
    move,
    notices,
    speed_limits,
    stop_within,
    time_to_cover,
)
from wibam_core.synthetic.layout import PARKING_M, Layout
from wibam_core.synthetic.risks import RED_RUN_S, Daring, Risks
from wibam_core.synthetic.routes import Route, make_routes
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.trajectories import Trajectory, without_overlaps
from wibam_core.synthetic.vehicles import sample_vehicle

Array = NDArray[np.float64]

#: The roads fill for so long before the recording begins.
WARM_UP_S = 45.0
#: Vehicles that arrive on each incoming lane at density 1.
ARRIVALS_PER_S = 0.09
#: The share of them that goes each way.
SHARES = {"straight": 0.52, "right": 0.20, "left": 0.28}
#: Of two whose paths cross, the one of the higher rank goes first.
_RANKS = {"straight": 2, "right": 1, "left": 0}


@dataclass(frozen=True, eq=False)
class Traffic:
    """What happens at an intersection over time: vehicles and signals."""

    layout: Layout
    program: SignalProgram
    trajectories: tuple[Trajectory, ...]
    duration_s: float

    def at(self, time_s: float) -> tuple[list[Trajectory], Array]:
        """The vehicles that are there at a time, and their boxes (N, 7)."""
        present, boxes = [], []
        for trajectory in self.trajectories:
            box = trajectory.box(time_s)
            if box is not None:
                present.append(trajectory)
                boxes.append(box)
        return present, np.array(boxes).reshape(-1, 7)


def simulate_traffic(
    layout: Layout,
    seed: int,
    duration_s: float,
    program: SignalProgram,
    density: float = 1.0,
    parked: int = 2,
    speed_mps: float = 12.5,
    risks: Risks = Risks(),
) -> Traffic:
    """Traffic on an intersection from time 0 to ``duration_s``, after a warm-up.

    Args:
        layout: the intersection.
        seed: of everything random.
        duration_s: how long.
        program: signals; time 0 is the traffic's.
        density: 1 is about 6 vehicles a minute and incoming lane.
        parked: number of vehicles that stand beside the road all the time.
        speed_mps: usual speed between intersections.
        risks: that drivers take. Where they crash, the later of the two is left out.
    """
    daring = Daring(risks, np.random.default_rng([seed, 47]))
    simulation = _Simulation(layout, np.random.default_rng([seed, 41]), program, density, speed_mps, daring)
    finished = simulation.run(duration_s)
    if risks != Risks():
        finished = without_overlaps(finished)
    finished += _park(
        layout, np.random.default_rng([seed, 43]), parked, max((t.vehicle_id for t in finished), default=0) + 1
    )
    return Traffic(layout, program, tuple(finished), duration_s)


class _Simulation:
    def __init__(
        self,
        layout: Layout,
        rng: np.random.Generator,
        program: SignalProgram,
        density: float,
        speed_mps: float,
        daring: Daring,
    ) -> None:
        self._rng, self._program, self._density, self._daring = rng, program, density, daring
        self._routes = make_routes(layout)
        self._zones = find_zones(self._routes)
        self._limits = [speed_limits(route, speed_mps) for route in self._routes]
        lanes: dict[tuple[int, int], list[int]] = {}
        for i, route in enumerate(self._routes):
            lanes.setdefault((route.incoming.number, route.lane), []).append(i)
        self._lanes = lanes
        self._waiting: dict[tuple[int, int], list[Driver]] = {lane: [] for lane in lanes}
        self._active: list[Driver] = []
        self._next_id = 1
        self._phases_inside: set[str] = set()

    def run(self, duration_s: float) -> list[Trajectory]:
        first, last = -round(WARM_UP_S / STEP_S), round(duration_s / STEP_S) + 1
        finished: list[Driver] = []
        for step in range(first, last + 1):
            self._arrive(step)
            for driver in self._active:
                driver.history_s.append(driver.s)
                driver.history_v.append(driver.v)
            states = self._program.states(step * STEP_S)
            self._phases_inside = {self._routes[d.route].incoming.phase for d in self._active if self._in_the_middle(d)}
            accelerations = [self._accelerate(driver, states) for driver in self._active]
            for driver, a in zip(self._active, accelerations, strict=True):
                move(driver, a)
            gone = [d for d in self._active if d.rear > self._routes[d.route].length_m]
            finished += gone
            self._active = [d for d in self._active if d not in gone]
        return [t for t in map(self._trajectory, sorted([*finished, *self._active], key=_by_id)) if t is not None]

    def _trajectory(self, driver: Driver) -> Trajectory | None:
        skip = max(0, -driver.first_step)
        s, v = np.array(driver.history_s[skip:]), np.array(driver.history_v[skip:])
        if len(s) < 2:
            return None
        first = max(driver.first_step, 0)
        return Trajectory(driver.vehicle_id, driver.model, self._routes[driver.route], first, s, v)

    # --- arrivals ---------------------------------------------------------------------------
    def _arrive(self, step: int) -> None:
        chance = self._density * ARRIVALS_PER_S * STEP_S
        for lane, routes in self._lanes.items():
            queue = self._waiting[lane]
            if self._rng.random() < chance and len(queue) < 4:
                queue.append(self._new_driver(routes))
            if not queue:
                continue
            driver = queue[0]
            ahead = [d.rear for d in self._active if self._zones.get((driver.route, d.route), _NONE).kind == "follow"]
            ahead = [rear for rear in ahead if rear < self._routes[driver.route].stop_s_m]
            free = min(ahead, default=1e9) - driver.model.length_m
            if free > 4.0:
                driver.s, driver.first_step = driver.model.length_m / 2, step
                driver.v = min(driver.v, max(0.0, (free - 3.0) / 1.6))
                self._active.append(queue.pop(0))

    def _new_driver(self, routes: Sequence[int]) -> Driver:
        rng = self._rng
        model = sample_vehicle(rng)
        shares = np.array([SHARES[self._routes[r].movement] for r in routes])
        if model.vehicle_class in (RoadUserClass.BUS, RoadUserClass.TRUCK):  # long vehicles avoid tight turns
            wide = {"straight": 1.0, "left": 0.1, "right": 1e-6}
            shares = shares * np.array([wide[self._routes[r].movement] for r in routes])
        route = int(routes[int(rng.choice(len(routes), p=shares / shares.sum()))])
        factor = float(np.clip(rng.normal(1.0, 0.12), 0.75, 1.3))
        heavy = model.vehicle_class in (RoadUserClass.BUS, RoadUserClass.TRUCK)
        driver = Driver(
            vehicle_id=self._next_id,
            model=model,
            route=route,
            s=0.0,
            v=float(self._limits[route][0]) * (0.85 if heavy else 1.0) * factor,
            speed_factor=factor * (0.85 if heavy else 1.0),
            headway_s=float(rng.uniform(0.9, 1.6)),
            margin_s=float(rng.uniform(0.1, 1.6)) + (0.6 if heavy else 0.0),
            first_step=0,
        )
        self._next_id += 1
        self._daring.touch(driver)
        return driver

    # --- driving ----------------------------------------------------------------------------
    def _accelerate(self, driver: Driver, states: dict[str, str]) -> float:
        route = self._routes[driver.route]
        limits = self._limits[driver.route]
        limit = float(limits[min(max(int(driver.s / 0.5), 0), len(limits) - 1)]) * driver.speed_factor
        best = free_acceleration(driver, limit)
        stop = self._stop_for_signal(driver, route, states)
        if stop is not None:
            best = min(best, stop_within(driver, stop))
        for other in self._active:
            if other is driver:
                continue
            zone = self._zones.get((driver.route, other.route))
            if zone is None:
                continue
            leader = self._leader_gap(driver, other, zone)
            if leader is not None:
                if notices(driver, leader, other.v):
                    best = min(best, follow(driver, limit, leader, other.v))
            elif zone.kind != "follow":
                stop = self._stop_for_zone(driver, other, zone, states)
                if stop is not None:
                    best = min(best, stop_within(driver, stop))
        return best

    def _stop_for_signal(self, driver: Driver, route: Route, states: dict[str, str]) -> float | None:
        """Gap to the stop line if the driver must stop there: at red, and until the middle is clear."""
        gap = route.stop_s_m - driver.front
        state = states[route.incoming.phase]
        if gap < -0.3:
            return None
        if state == "green":
            driver.committed = False
            clear = driver.impatient or self._phases_inside <= {
                route.incoming.phase
            }  # others may still be leaving the middle
            return None if clear or gap < driver.v**2 / (2 * 4.0) else gap
        late = driver.v * RED_RUN_S if driver.runs_red else 0.0
        if state == "amber" and (driver.committed or gap < max(driver.v**2 / (2 * 3.0), late)):
            driver.committed = True
            return None
        return None if driver.committed and gap < max(driver.v**2 / (2 * EMERGENCY_MPS2), late) else gap

    def _leader_gap(self, me: Driver, other: Driver, zone: Zone) -> float | None:
        """Gap to another vehicle that is ahead on the same lane."""
        if zone.kind == "follow":
            ahead = other.s > me.s or (other.s == me.s and other.vehicle_id < me.vehicle_id)
            if not ahead or other.rear > zone.other_end_m or me.rear > zone.end_m:
                return None
            return other.rear - me.front
        if zone.kind == "merge" and other.front > zone.other_start_m and other.s + zone.to_exit_m > me.s:
            return other.rear + zone.to_exit_m - me.front
        return None

    def _stop_for_zone(self, me: Driver, other: Driver, zone: Zone, states: dict[str, str]) -> float | None:
        """Gap to the zone shared with another vehicle's route if the driver must let that one go first."""
        if other.rear > zone.other_end_m or me.front > zone.start_m:
            return None
        distance = zone.start_m - me.front
        if distance > 45 or not self._must_yield(me, other, zone, states):
            return None
        inside = other.front > zone.other_start_m
        route = self._routes[me.route]
        to_line = route.stop_s_m - me.front
        if to_line > -0.3 and (inside or route.movement != "left") and to_line >= me.v**2 / (2 * 4.0):
            return to_line  # only turns to the left wait in the middle
        if distance < me.v**2 / (2 * (EMERGENCY_MPS2 if inside else 4.0)):
            return None
        return distance

    def _in_the_middle(self, driver: Driver) -> bool:
        route = self._routes[driver.route]
        return driver.front > route.stop_s_m and driver.rear < route.box_s_m[1]

    def _must_yield(self, me: Driver, other: Driver, zone: Zone, states: dict[str, str]) -> bool:
        mine, its = self._routes[me.route], self._routes[other.route]
        inside = other.front > zone.other_start_m
        if not inside and other.front < its.stop_s_m + 0.3:
            gap = its.stop_s_m - other.front
            state = states[its.incoming.phase]
            if state == "red" or (state == "amber" and gap > other.v**2 / 6) or gap > 40:
                return False
        if not inside:
            me_in, it_in = me.front > mine.stop_s_m + 0.3, other.front > its.stop_s_m + 0.3
            rank = (me_in, _RANKS[mine.movement])
            its_rank = (it_in, _RANKS[its.movement])
            if its.incoming.phase == mine.incoming.phase:  # both have green: right of way decides alone
                rank, its_rank = (True, rank[1]), (True, its_rank[1])
            if rank > its_rank:
                return False
            if rank == its_rank and (zone.start_m - me.front, me.vehicle_id) < (
                zone.other_start_m - other.front,
                other.vehicle_id,
            ):
                return False
        mine_in = max(zone.start_m - me.front, 0.0) / max(me.v, 0.5)
        mine_out = time_to_cover(zone.end_m - me.rear if zone.kind == "cross" else zone.start_m - me.rear, me.v)
        its_v = max(other.v, 0.5 if inside else 3.0)
        its_in = max(zone.other_start_m - other.front, 0.0) / its_v
        end = zone.other_end_m if zone.kind == "cross" else zone.other_start_m
        its_out = max(end - other.rear, 0.0) / its_v
        return not (mine_out + me.margin_s < its_in or mine_in > its_out + 0.4)


_NONE = Zone("cross", 0.0, 0.0, 0.0, 0.0)


def _by_id(driver: Driver) -> int:
    return driver.vehicle_id


def _park(layout: Layout, rng: np.random.Generator, count: int, first_id: int) -> list[Trajectory]:
    bays = [(arm, side, k) for arm in layout.arms if arm.parking for side in (1, -1) for k in range(5)]
    chosen = rng.permutation(len(bays))[:count]
    parked: list[Trajectory] = []
    for i in chosen:
        arm, side, k = bays[i]
        model = sample_vehicle(rng, {RoadUserClass.CAR: 0.9, RoadUserClass.VAN: 0.1})
        edge = arm.in_edge_m if side > 0 else -arm.out_edge_m
        x, y = arm.point(arm.parking_start_m + 5 + 7.5 * k, side * (edge + PARKING_M / 2))
        yaw = arm.heading_rad + (np.pi if side > 0 else 0.0)
        yaw = float(np.arctan2(np.sin(yaw), np.cos(yaw)))
        none = np.zeros(0)
        parked.append(Trajectory(first_id + len(parked), model, None, 0, none, none, (float(x), float(y), yaw)))
    return parked
