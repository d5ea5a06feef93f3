"""Paths through an intersection: along an incoming lane, over the middle, and out along another arm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.geometry.box3d import LENGTH, WIDTH, XY, YAW, footprints
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.synthetic.layout import Arm, Layout

Array = NDArray[np.float64]
Movement = Literal["left", "straight", "right"]

#: Axles lie this share of the length before and behind the middle of a vehicle.
AXLE_SHARE = 0.29
_STEP_M = 0.5


@dataclass(frozen=True, eq=False)
class Route:
    """One way to cross the intersection. ``s`` is the distance along it in m, 0 at the far end of the incoming lane.

    Attributes:
        incoming, lane: where it comes from; lane 0 is the innermost.
        outgoing, exit_lane: where it leads.
        movement: left, straight or right.
        stop_s_m: stop line. box_s_m: the rounded middle lies between these two.
        points: (M, 2) the path at steps of equal length, straight beyond both ends.
    """

    incoming: Arm
    lane: int
    outgoing: Arm
    exit_lane: int
    movement: Movement
    stop_s_m: float
    box_s_m: tuple[float, float]
    points: Array

    @cached_property
    def s_m(self) -> Array:
        """(M,) distance along the route of every point."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])

    @property
    def length_m(self) -> float:
        return float(self.s_m[-1])

    @cached_property
    def curvature(self) -> Array:
        """(M,) 1/m, positive to the left."""
        d = np.gradient(self.points, self.s_m, axis=0)
        heading = np.unwrap(np.arctan2(d[:, 1], d[:, 0]))
        return np.asarray(np.gradient(heading, self.s_m))

    def position(self, s_m: ArrayLike) -> Array:
        """World points (..., 2) at distances (...); beyond the ends the path goes straight on."""
        s = np.asarray(s_m, dtype=np.float64)
        x = np.interp(s, self.s_m, self.points[:, 0])
        y = np.interp(s, self.s_m, self.points[:, 1])
        first, last = self.points[1] - self.points[0], self.points[-1] - self.points[-2]
        before = np.minimum(s, 0.0)[..., None] * first / np.linalg.norm(first)
        after = np.maximum(s - self.length_m, 0.0)[..., None] * last / np.linalg.norm(last)
        return np.asarray(np.stack([x, y], axis=-1) + before + after)

    def poses(self, s_m: ArrayLike, length_m: ArrayLike) -> Array:
        """Centre and yaw (..., 3) of vehicles of the given lengths whose axles run on the path about ``s_m``."""
        s = np.asarray(s_m, dtype=np.float64)
        reach = AXLE_SHARE * np.asarray(length_m, dtype=np.float64)
        front, rear = self.position(s + reach), self.position(s - reach)
        d = front - rear
        yaw = np.arctan2(d[..., 1], d[..., 0])
        return np.concatenate([(front + rear) / 2, yaw[..., None]], axis=-1)


def make_routes(layout: Layout) -> tuple[Route, ...]:
    """All routes of an intersection: inner lanes turn left, outer ones right, all go straight where there is an arm."""
    routes = []
    for arm in layout.arms:
        for target in layout.arms:
            if target is arm:
                continue
            movement = _movement(arm, target)
            for lane in _lanes_for(arm, movement, layout):
                exit_lane = {
                    "left": 0,
                    "right": target.outgoing - 1,
                    "straight": min(lane, target.outgoing - 1),
                }[movement]
                routes.append(_route(arm, lane, target, exit_lane, movement))
    return tuple(routes)


def _movement(arm: Arm, target: Arm) -> Movement:
    turn = float(normalise_angle(target.heading_rad - (arm.heading_rad + np.pi)))
    if abs(turn) < np.pi / 4:
        return "straight"
    return "left" if turn > 0 else "right"


def _lanes_for(arm: Arm, movement: Movement, layout: Layout) -> list[int]:
    if movement == "left":
        return [0]
    if movement == "right":
        return [arm.incoming - 1]
    movements = {_movement(arm, t) for t in layout.arms if t is not arm}
    lanes = list(range(arm.incoming))
    return lanes if arm.incoming == 1 or "left" not in movements else lanes[:] if arm.incoming < 3 else lanes[1:]


def _route(arm: Arm, lane: int, target: Arm, exit_lane: int, movement: Movement) -> Route:
    lateral_in, lateral_out = arm.lane_lateral_m(lane, True), target.lane_lateral_m(exit_lane, False)
    start, end = arm.point(arm.kerb_m, lateral_in), target.point(target.kerb_m, lateral_out)
    direction_in, direction_out = -arm.axis, target.axis
    if movement == "straight":
        handle_in = handle_out = float(np.linalg.norm(end - start)) / 3
    else:
        meet = np.linalg.solve(np.stack([direction_in, -direction_out], axis=1), end - start)
        handle_in, handle_out = (0.62 * float(np.clip(h, 2.0, 40.0)) for h in (meet[0], -meet[1] * -1))
    t = np.linspace(0, 1, 120)[:, None]
    controls = (start, start + handle_in * direction_in, end - handle_out * direction_out, end)
    curve = (
        (1 - t) ** 3 * controls[0]
        + 3 * (1 - t) ** 2 * t * controls[1]
        + 3 * (1 - t) * t**2 * controls[2]
        + t**3 * controls[3]
    )
    far_in, far_out = arm.point(arm.length_m, lateral_in), target.point(target.length_m, lateral_out)
    rough = np.concatenate([far_in[None], curve, far_out[None]])
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rough, axis=0), axis=1))])
    even = np.linspace(0, distance[-1], int(distance[-1] / _STEP_M) + 1)
    points = np.stack([np.interp(even, distance, rough[:, i]) for i in (0, 1)], axis=-1)
    entry = arm.length_m - arm.kerb_m
    return Route(
        incoming=arm,
        lane=lane,
        outgoing=target,
        exit_lane=exit_lane,
        movement=movement,
        stop_s_m=arm.length_m - arm.stop_m,
        box_s_m=(entry, distance[-1] - (target.length_m - target.kerb_m)),
        points=points,
    )


def footprints_overlap(a: ArrayLike, b: ArrayLike) -> NDArray[np.bool_]:
    """Whether the ground rectangles of boxes (..., 7) and (..., 7) overlap, (...): separating axes of both."""
    one, two = np.broadcast_arrays(np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64))
    apart = np.zeros(one.shape[:-1], bool)
    for first, second in ((one, two), (two, one)):
        c, s = np.cos(first[..., YAW]), np.sin(first[..., YAW])
        d = footprints(second) - first[..., None, XY]
        x = c[..., None] * d[..., 0] + s[..., None] * d[..., 1]
        y = c[..., None] * d[..., 1] - s[..., None] * d[..., 0]
        for values, half in ((x, first[..., LENGTH] / 2), (y, first[..., WIDTH] / 2)):
            apart |= (values.min(-1) >= half) | (values.max(-1) <= -half)
    return ~apart
