"""Traffic at a crossing whose arms have green one after the other.

The front axle runs along the lane, and the rear axle follows it as a trailer's does (a tractrix), so that bodies cut
corners as real ones. Drivers keep the distance of the intelligent driver model (Treiber, Hennecke & Helbing 2000,
Phys. Rev. E 62) to whatever is ahead on their way.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from benchmarks.other_bodies.catalogue import BodyModel
from benchmarks.other_bodies.materials import Finish

Array = NDArray[np.float64]

STEP_S = 0.1
_ARM_M = 75.0
_GREEN_S, _CLEARING_S = 8.0, 2.5
_SPEED_MPS, _TURN_MPS = 11.5, 5.5
_ACCELERATION_MPS2, _BRAKING_MPS2 = 1.7, 2.3
_LANE_M = 3.4
#: The way ahead is free if nobody is within this distance of it, m.
_CLEAR_M = 1.75
_BEFORE_S = 30.0


@dataclass(frozen=True)
class Crossing:
    """Arms with one lane each way: directions (rad) in which they lead away, and where vehicles stop, m from the
    middle.

    Attributes:
        parking: (N, 3) x, y and yaw of parked vehicles.
    """

    arms_rad: tuple[float, ...]
    stop_m: float
    parking: tuple[tuple[float, float, float], ...] = ()

    @classmethod
    def sample(cls, rng: np.random.Generator, arms: int, parked: int) -> Crossing:
        turn = rng.uniform(-np.pi, np.pi)
        directions = turn + np.arange(arms) * 2 * np.pi / max(arms, 4) + rng.normal(0, 0.10, arms)
        places = []
        for k in range(parked):
            a = directions[k % arms]
            side = 1 if k % 2 else -1
            along = rng.uniform(20, 32)
            d, n = np.array([np.cos(a), np.sin(a)]), np.array([-np.sin(a), np.cos(a)])
            x, y = along * d + side * (_LANE_M + 1.35) * n
            places.append((float(x), float(y), float(a + (np.pi if side > 0 else 0))))
        return cls(tuple(directions.tolist()), rng.uniform(11.0, 13.0), tuple(places))

    def path(self, origin: int, target: int) -> Array:
        """(M, 2) points of a way, 0.5 m apart: in along one arm on the right, and out along another."""
        a, b = self.arms_rad[origin], self.arms_rad[target]
        u, v = np.array([np.cos(a), np.sin(a)]), np.array([np.cos(b), np.sin(b)])
        start = u * self.stop_m + _LANE_M / 2 * np.array([-u[1], u[0]])
        end = v * self.stop_m + _LANE_M / 2 * np.array([v[1], -v[0]])
        reach = 0.6 * np.linalg.norm(end - start)
        t = np.linspace(0, 1, 60)[:, None]
        # cubic Hermite curve
        bend = (2 * t**3 - 3 * t**2 + 1) * start + (t**3 - 2 * t**2 + t) * (-u * reach * 1.6)
        bend = bend + (-2 * t**3 + 3 * t**2) * end + (t**3 - t**2) * (v * reach * 1.6)
        whole = np.concatenate([[start + u * (_ARM_M - self.stop_m)], bend, [end + v * (_ARM_M - self.stop_m)]])
        s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(whole, axis=0), axis=1))])
        even = np.arange(0, s[-1], 0.5)
        return np.stack([np.interp(even, s, whole[:, k]) for k in (0, 1)], axis=-1)

    def is_green(self, arm: int, time_s: float) -> bool:
        period = _GREEN_S + _CLEARING_S
        phase = (time_s + 1000 * period * len(self.arms_rad)) % (period * len(self.arms_rad))
        return arm * period <= phase < arm * period + _GREEN_S


@dataclass(eq=False)
class Vehicle:
    """One vehicle and where it has been.

    Attributes:
        vehicle_id, model, finish: who it is.
        path: (M, 2) way of its front axle. origin: arm that it comes from.
        s_m, v_mps: of the front axle, along the path. rear: (2,) rear axle.
        times_s: since the recordings' start. poses: x, y and yaw of the middle of its box at those times.
    """

    vehicle_id: int
    model: BodyModel
    finish: Finish
    path: Array
    origin: int
    s_m: float
    v_mps: float
    rear: Array
    times_s: list[float] = field(default_factory=list)
    poses: list[tuple[float, float, float]] = field(default_factory=list)

    @property
    def front(self) -> Array:
        at = min(int(self.s_m / 0.5), len(self.path) - 2)
        return np.asarray(self.path[at] + (self.s_m / 0.5 - at) * (self.path[at + 1] - self.path[at]))

    def remember(self, time_s: float) -> None:
        d = self.front - self.rear
        yaw = float(np.arctan2(d[1], d[0]))
        ahead = self.model.wheelbase_m + self.model.front_overhang_m - self.model.length_m / 2
        x, y = self.rear + ahead * np.array([np.cos(yaw), np.sin(yaw)])
        self.times_s.append(time_s)
        self.poses.append((float(x), float(y), yaw))

    def axis(self) -> Array:
        """(3, 2) rear, middle and front of its body."""
        x, y, yaw = self.poses[-1]
        half = self.model.length_m / 2 - 0.8
        return np.array([x, y]) + np.array([-half, 0.0, half])[:, None] * np.array([np.cos(yaw), np.sin(yaw)])

    def pose_at(self, time_s: float) -> Array | None:
        """(3,) x, y and yaw, or None while it is not there."""
        if not self.times_s or not self.times_s[0] <= time_s <= self.times_s[-1]:
            return None
        poses = np.array(self.poses)
        yaw = np.unwrap(poses[:, 2])
        return np.array([np.interp(time_s, self.times_s, column) for column in (poses[:, 0], poses[:, 1], yaw)])


def drive(
    crossing: Crossing, models: tuple[BodyModel, ...], seconds: float, per_minute: float, rng: np.random.Generator
) -> list[Vehicle]:
    """All vehicles of a recording of so many seconds, with so many new ones a minute and arm."""
    weights = np.array([model.weight for model in models])
    everyone: list[Vehicle] = []
    there: list[Vehicle] = []

    def new(path: Array, origin: int, s: float, v: float, model: BodyModel) -> Vehicle:
        d = path[1] - path[0]
        made = Vehicle(len(everyone) + 1, model, Finish.sample(rng, model), path, origin, s, v, np.zeros(2))
        made.rear = made.front - model.wheelbase_m * d / np.linalg.norm(d)
        everyone.append(made)
        return made

    for x, y, yaw in crossing.parking:
        small = [model for model in models if model.length_m < 5.0]
        model = small[rng.integers(len(small))]
        looks = Finish.sample(rng, model)
        standing = Vehicle(len(everyone) + 1, model, looks, np.zeros((2, 2)), -1, 0.0, 0.0, np.zeros(2))
        standing.times_s, standing.poses = [-1e3, 1e6], [(x, y, yaw)] * 2
        everyone.append(standing)
    arms = range(len(crossing.arms_rad))
    due = {arm: -_BEFORE_S + rng.exponential(60.0 / per_minute) for arm in arms}
    for step in range(int((seconds + _BEFORE_S) / STEP_S) + 2):
        time_s = step * STEP_S - _BEFORE_S
        for arm in arms:
            entry = [v for v in there if v.origin == arm and v.s_m < 22]
            if time_s >= due[arm] and not entry:
                due[arm] = max(time_s, due[arm]) + rng.exponential(60.0 / per_minute)
                model = models[rng.choice(len(models), p=weights / weights.sum())]
                targets = [t for t in arms if t != arm]
                if model.length_m > 13:  # an articulated one is a single box only while it goes straight on
                    bend = [abs(abs(_turn(crossing.arms_rad[arm], crossing.arms_rad[t])) - np.pi) for t in targets]
                    target = targets[int(np.argmin(bend))]
                else:
                    target = targets[rng.integers(len(targets))]
                there.append(new(crossing.path(arm, target), arm, model.wheelbase_m + 0.5, _SPEED_MPS * 0.8, model))
                there[-1].remember(time_s)
        parked = [v for v in everyone if v.origin < 0]
        pushes = [_acceleration(v, there + parked, crossing, time_s) for v in there]
        for vehicle, push in zip(there, pushes, strict=True):
            _advance(vehicle, push)
            vehicle.remember(time_s + STEP_S)
        there = [v for v in there if v.s_m < 0.5 * (len(v.path) - 2)]
    return everyone


def _turn(a: float, b: float) -> float:
    return float((b - a + np.pi) % (2 * np.pi) - np.pi)


def _advance(vehicle: Vehicle, push: float) -> None:
    v = max(0.0, vehicle.v_mps + push * STEP_S)
    moved, vehicle.v_mps = 0.5 * (vehicle.v_mps + v) * STEP_S, v
    for _ in range(4):  # the rear axle follows in small steps
        vehicle.s_m += moved / 4
        d = vehicle.front - vehicle.rear
        vehicle.rear = vehicle.front - vehicle.model.wheelbase_m * d / np.linalg.norm(d)


def _acceleration(me: Vehicle, others: list[Vehicle], crossing: Crossing, time_s: float) -> float:
    at = int(me.s_m / 0.5)
    bumper = me.model.front_overhang_m
    ahead = me.path[at : at + 90]
    direction = np.diff(me.path[at : at + 50], axis=0)
    heading = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0])) if len(direction) else np.zeros(1)
    bend = np.abs(np.diff(heading)).max(initial=0.0) / 0.5
    limit = min(_SPEED_MPS, max(_TURN_MPS, _SPEED_MPS - 60 * bend)) if bend > 0.02 else _SPEED_MPS
    gaps = [(np.inf, 0.0)]
    stop_s = _ARM_M - crossing.stop_m - 1.0
    to_line = stop_s - me.s_m - bumper
    if to_line > -1.0 and not crossing.is_green(me.origin, time_s) and to_line > me.v_mps**2 / 9 - 1.0:
        gaps.append((max(to_line, 0.05), 0.0))
    for other in others:
        if other is me:
            continue
        axis = other.axis()
        if np.linalg.norm(axis[1] - ahead[0]) > 50:
            continue
        near = np.linalg.norm(ahead[:, None] - axis[None], axis=-1).min(axis=1)
        met = np.flatnonzero(near < _CLEAR_M)
        if len(met) and met[0] * 0.5 > 0.5:
            gaps.append((max(met[0] * 0.5 - bumper, 0.05), other.v_mps))
    push = _ACCELERATION_MPS2 * (1 - (me.v_mps / limit) ** 4)
    for gap, speed in gaps:
        closing = me.v_mps * (me.v_mps - speed) / (2 * np.sqrt(_ACCELERATION_MPS2 * _BRAKING_MPS2))
        desired = 2.0 + max(0.0, 1.2 * me.v_mps + closing)
        push = min(push, _ACCELERATION_MPS2 * (1 - (me.v_mps / limit) ** 4 - (desired / gap) ** 2))
    return float(np.clip(push, -6.0, _ACCELERATION_MPS2))
