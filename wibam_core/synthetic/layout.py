"""Parametric signalised intersections: arms, lanes, kerbs, buildings, poles, trees and signal heads.

An arm points outward from the centre of the intersection. Along an arm, ``along`` is the distance from the centre
and ``lateral`` is positive to the left of the outward direction. Traffic keeps to the right, so the lanes that lead
towards the centre ("incoming") have positive ``lateral`` and the outgoing ones negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

SIDEWALK_M = 3.2
PARKING_M = 2.4
CROSSWALK_M = 3.0

#: Names of the two signal phases: arms with even numbers show "a", odd ones "b".
PHASES = ("a", "b")


@dataclass(frozen=True)
class Arm:
    """One road that leads out of the intersection.

    Attributes:
        number: arms lie about a quarter turn apart; the number counts quarters, so 0 and 2 are opposite.
        heading_rad: outward direction.
        incoming, outgoing: numbers of lanes.
        lane_m: lane width.
        kerb_m: distance from the centre at which the rounded corners have become straight kerbs.
        length_m: where the arm ends.
        parking: a strip for parked vehicles lies beside both outer lanes, beyond the stop line.
    """

    number: int
    heading_rad: float
    incoming: int
    outgoing: int
    lane_m: float
    kerb_m: float
    length_m: float
    parking: bool

    @property
    def phase(self) -> str:
        return PHASES[self.number % 2]

    @property
    def axis(self) -> Array:
        return np.array([np.cos(self.heading_rad), np.sin(self.heading_rad)])

    @property
    def normal(self) -> Array:
        return np.array([-np.sin(self.heading_rad), np.cos(self.heading_rad)])

    @property
    def crosswalk_m(self) -> tuple[float, float]:
        """The crosswalk lies between these distances from the centre."""
        return self.kerb_m + 0.4, self.kerb_m + 0.4 + CROSSWALK_M

    @property
    def stop_m(self) -> float:
        """Distance of the stop line from the centre."""
        return self.crosswalk_m[1] + 1.2

    @property
    def in_edge_m(self) -> float:
        """Lateral position of the kerb on the incoming side (parking strip left out)."""
        return self.incoming * self.lane_m

    @property
    def out_edge_m(self) -> float:
        """Lateral position of the kerb on the outgoing side (negative)."""
        return -self.outgoing * self.lane_m

    @property
    def parking_start_m(self) -> float:
        return self.stop_m + 10.0

    def point(self, along: ArrayLike, lateral: ArrayLike) -> Array:
        """World x, y (..., 2) of arm coordinates (...)."""
        a = np.asarray(along, dtype=np.float64)[..., None]
        lat = np.asarray(lateral, dtype=np.float64)[..., None]
        return np.asarray(a * self.axis + lat * self.normal)

    def strip(self, along0: float, along1: float, lateral0: float, lateral1: float) -> Array:
        """(4, 2) ground rectangle between the given arm coordinates."""
        return self.point([along0, along1, along1, along0], [lateral0, lateral0, lateral1, lateral1])

    def lane_lateral_m(self, lane: int, incoming: bool) -> float:
        """Centre line of a lane; lane 0 is the innermost."""
        return (lane + 0.5) * self.lane_m * (1 if incoming else -1)


@dataclass(frozen=True, eq=False)
class Building:
    """An upright block: ``footprint`` (4, 2) counter-clockwise, m, with windows every ``storey_m``."""

    footprint: Array
    height_m: float
    colour: Colour
    storey_m: float


@dataclass(frozen=True)
class Pole:
    x_m: float
    y_m: float
    height_m: float
    radius_m: float
    colour: Colour


@dataclass(frozen=True)
class Tree:
    x_m: float
    y_m: float
    height_m: float
    crown_m: float
    colour: Colour


@dataclass(frozen=True)
class SignalHead:
    """A signal head with three lamps, red on top.

    Attributes:
        phase: of `PHASES`; all heads of one phase change together.
        x_m, y_m, z_m: centre of the head. facing_rad: direction in which the lamps shine.
        pole_x_m, pole_y_m: foot of its pole; a bracket leads from the pole to the head.
    """

    phase: str
    x_m: float
    y_m: float
    z_m: float
    facing_rad: float
    pole_x_m: float
    pole_y_m: float

    WIDTH_M = 0.46
    HEIGHT_M = 1.25

    def outline(self, margin_m: float = 0.0) -> Array:
        """(4, 3) corners of the head's face: bottom left, bottom right, top right, top left, seen from the front."""
        c, s = np.cos(self.facing_rad), np.sin(self.facing_rad)
        right = np.array([-s, c, 0.0])  # to the right of somebody who looks at the lamps
        up = np.array([0.0, 0.0, 1.0])
        w, h = self.WIDTH_M / 2 + margin_m, self.HEIGHT_M / 2 + margin_m
        centre = np.array([self.x_m, self.y_m, self.z_m]) + 0.12 * np.array([c, s, 0])
        return np.stack([centre - w * right - h * up, centre + w * right - h * up, centre + w * right + h * up,
                         centre - w * right + h * up])  # fmt: skip

    def lamp_centres(self) -> Array:
        """(3, 3) centres of the red, amber and green lamp."""
        corners = self.outline()
        middle = corners.mean(axis=0)
        return middle + np.array([1.0, 0.0, -1.0])[:, None] * np.array([0, 0, self.HEIGHT_M * 0.31])

    @property
    def lamp_radius_m(self) -> float:
        return 0.17


@dataclass(frozen=True, eq=False)
class Layout:
    """One intersection. The centre is the world's origin and the ground is z = 0."""

    seed: int
    arms: tuple[Arm, ...]
    buildings: tuple[Building, ...]
    poles: tuple[Pole, ...]
    trees: tuple[Tree, ...]
    signals: tuple[SignalHead, ...]
    asphalt: Colour
    sidewalk: Colour
    terrain: Colour

    @cached_property
    def junction(self) -> Array:
        """(M, 2) outline of the paved middle with rounded corners."""
        return _rounded_outline(self.arms, 0.0)

    @cached_property
    def junction_sidewalk(self) -> Array:
        """(M, 2) outline of the middle with its sidewalk."""
        return _rounded_outline(self.arms, SIDEWALK_M)

    def corner_points(self) -> Array:
        """(A, 2) points on the sidewalk between neighbouring arms, behind the rounded kerb."""
        points = []
        for arm, other in _neighbours(self.arms):
            bisector = arm.heading_rad + 0.5 * _turn(arm, other)
            direction = np.array([np.cos(bisector), np.sin(bisector)])
            reach = max(arm.kerb_m, other.kerb_m)
            points.append(direction * (reach if _turn(arm, other) < 2.5 else max(arm.in_edge_m, -other.out_edge_m) + 2))
        return np.array(points)

    def is_free(self, x_m: float, y_m: float, clearance_m: float) -> bool:
        """Whether no building, pole or tree is nearer than the clearance."""
        point = (float(x_m), float(y_m))
        for building in self.buildings:
            if cv2.pointPolygonTest(building.footprint.astype(np.float32), point, True) > -clearance_m:
                return False
        things: tuple[Pole | Tree, ...] = (*self.poles, *self.trees)
        return all(np.hypot(o.x_m - x_m, o.y_m - y_m) > clearance_m for o in things)


def _turn(arm: Arm, other: Arm) -> float:
    """Counter-clockwise angle from one arm to another, in (0, 2π]."""
    return float((other.heading_rad - arm.heading_rad - 1e-9) % (2 * np.pi) + 1e-9)


def _neighbours(arms: tuple[Arm, ...]) -> list[tuple[Arm, Arm]]:
    return [(arm, arms[(i + 1) % len(arms)]) for i, arm in enumerate(arms)]


def _kerb_crossing(lateral_a: float, lateral_b: float, turn: float) -> float:
    """Distance along arm a at which its left kerb meets the right kerb of the arm ``turn`` further on."""
    return (lateral_b + lateral_a * np.cos(turn)) / np.sin(turn)


def _rounded_outline(arms: tuple[Arm, ...], widen_m: float) -> Array:
    points: list[Array] = []
    share = np.linspace(0, 1, 9)[:, None]
    for arm, other in _neighbours(arms):
        turn = _turn(arm, other)
        start = arm.point(arm.kerb_m, arm.in_edge_m + widen_m)
        end = other.point(other.kerb_m, other.out_edge_m - widen_m)
        if turn < 2.5:
            lateral = arm.in_edge_m + widen_m
            control = arm.point(_kerb_crossing(lateral, -other.out_edge_m + widen_m, turn), lateral)
        else:
            control = (start + end) / 2
        points.append(arm.point(arm.kerb_m, arm.out_edge_m - widen_m)[None])
        points.append((1 - share) ** 2 * start + 2 * share * (1 - share) * control + share**2 * end)
    return np.concatenate(points)


def make_layout(seed: int) -> Layout:
    """An intersection of its own for every seed: four arms, in about a quarter of the seeds three."""
    rng = np.random.default_rng([seed, 11])
    arms = _make_arms(rng)
    grey = rng.uniform(70, 120)
    warm = rng.uniform(-6, 6)
    grass = bool(rng.random() < 0.6)
    terrain = (60.0, 105.0, 85.0) if grass else (125.0, 135.0, 140.0)
    shade = rng.uniform(0.8, 1.2)
    buildings = _make_buildings(rng, arms)
    signals = _make_signals(rng, arms)
    pole_colour = (float(rng.uniform(60, 140)),) * 3
    poles = [Pole(s.pole_x_m, s.pole_y_m, s.z_m + 0.3, 0.09, pole_colour) for s in signals]
    lamps, trees = _make_street_furniture(rng, arms, buildings, pole_colour)
    return Layout(
        seed=seed,
        arms=arms,
        buildings=buildings,
        poles=(*poles, *lamps),
        trees=trees,
        signals=signals,
        asphalt=(grey + warm, grey, grey - warm),
        sidewalk=(grey + 45 + warm, grey + 48, grey + 50 - warm),
        terrain=(terrain[0] * shade, terrain[1] * shade, terrain[2] * shade),
    )


def _make_arms(rng: np.random.Generator) -> tuple[Arm, ...]:
    numbers = [0, 1, 2, 3]
    if rng.random() < 0.25:
        numbers.remove(int(rng.integers(4)))
    start = rng.uniform(-np.pi, np.pi)
    lane = rng.uniform(3.0, 3.6)
    lanes = {parity: (int(rng.integers(1, 3)), int(rng.integers(1, 3))) for parity in (0, 1)}
    rough = [
        Arm(
            number=n,
            heading_rad=start + n * np.pi / 2 + rng.uniform(-0.1, 0.1),
            incoming=lanes[n % 2][0],
            outgoing=lanes[n % 2][1] if n < 2 else lanes[n % 2][0],
            lane_m=lane,
            kerb_m=0.0,
            length_m=95.0,
            parking=bool(rng.random() < 0.6),
        )
        for n in numbers
    ]
    radius = rng.uniform(4.0, 7.0)
    kerbs = dict.fromkeys(numbers, 0.0)
    for arm, other in _neighbours(tuple(rough)):
        turn = _turn(arm, other)
        if turn < 2.5:
            a = _kerb_crossing(arm.in_edge_m, -other.out_edge_m, turn)
            b = _kerb_crossing(-other.out_edge_m, arm.in_edge_m, turn)
            kerbs[arm.number] = max(kerbs[arm.number], a + radius)
            kerbs[other.number] = max(kerbs[other.number], b + radius)
    return tuple(
        Arm(a.number, a.heading_rad, a.incoming, a.outgoing, a.lane_m, kerbs[a.number], a.length_m, a.parking)
        for a in rough
    )


def road_distance_m(arms: tuple[Arm, ...], points: ArrayLike) -> Array:
    """How far ground points (..., 2) lie outside the roads, m; 0 or less on a road."""
    xy = np.asarray(points, dtype=np.float64)
    distances = []
    for arm in arms:
        along, lateral = xy @ arm.axis, xy @ arm.normal
        extra = PARKING_M if arm.parking else 0.0
        outside = np.maximum(lateral - arm.in_edge_m - extra, arm.out_edge_m - extra - lateral)
        distances.append(np.where(along > 0, outside, np.hypot(outside.clip(0), along)))
    return np.asarray(np.min(distances, axis=0))


def _make_buildings(rng: np.random.Generator, arms: tuple[Arm, ...]) -> tuple[Building, ...]:
    found: list[Building] = []
    for arm in arms:
        for side in (1, -1):
            along = arm.stop_m + rng.uniform(4, 14)
            while along < arm.length_m + 10:
                width, depth = rng.uniform(10, 26), rng.uniform(9, 16)
                edge = (arm.in_edge_m if side > 0 else -arm.out_edge_m) + (PARKING_M if arm.parking else 0)
                near = edge + SIDEWALK_M + rng.uniform(0.5, 7)
                strip = arm.strip(along, along + width, side * near, side * (near + depth))
                footprint = strip if side > 0 else strip[::-1]
                clear = road_distance_m(arms, _outline_samples(footprint)).min() > SIDEWALK_M
                if rng.random() < 0.75 and clear and not any(_overlap(footprint, b.footprint) for b in found):
                    base = rng.uniform(90, 215)
                    colour = (base * rng.uniform(0.75, 1.0), base * rng.uniform(0.85, 1.0), base)
                    found.append(Building(footprint, rng.uniform(6, 24), colour, rng.uniform(2.8, 3.6)))
                along += width + rng.uniform(1, 12)
    return tuple(found)


def _outline_samples(quad: Array) -> Array:
    share = np.linspace(0, 1, 6)[:, None]
    return np.concatenate([quad[i] * (1 - share) + quad[(i + 1) % 4] * share for i in range(4)])


def _overlap(a: Array, b: Array) -> bool:
    area, _ = cv2.intersectConvexConvex(a.astype(np.float32), b.astype(np.float32))
    return bool(area > 0.1)


def _head(arm: Arm, place: Array, foot: Array, height_m: float) -> SignalHead:
    """The head at a ground place that shows an arm's phase to the traffic that comes in along it."""
    (x, y), (foot_x, foot_y) = place.tolist(), foot.tolist()
    return SignalHead(arm.phase, x, y, height_m, arm.heading_rad, foot_x, foot_y)


def _make_signals(rng: np.random.Generator, arms: tuple[Arm, ...]) -> tuple[SignalHead, ...]:
    heads = []
    for arm in arms:
        edge = arm.in_edge_m + 0.9
        near = arm.point(arm.stop_m - 0.5, edge)
        heads.append(_head(arm, near, near, rng.uniform(3.0, 3.6)))
        opposite = next((o for o in arms if (o.number - arm.number) % 4 == 2), None)
        overhang = float(rng.uniform(1.2, 2.6))
        if opposite is not None:
            along, kerb = opposite.kerb_m, opposite.out_edge_m
            foot, head = opposite.point(along, kerb - 0.9), opposite.point(along, kerb - 0.9 + overhang)
        else:  # straight on is no road: on the sidewalk there
            reach = np.arange(2.0, 30.0, 0.25)
            beyond = arm.point(-reach, np.full(len(reach), edge))
            foot = beyond[np.argmax(road_distance_m(arms, beyond) > 0.7)]
            head = foot - overhang * arm.normal
        heads.append(_head(arm, head, foot, rng.uniform(4.6, 5.4)))
    return tuple(heads)


def _make_street_furniture(
    rng: np.random.Generator, arms: tuple[Arm, ...], buildings: tuple[Building, ...], colour: Colour
) -> tuple[tuple[Pole, ...], tuple[Tree, ...]]:
    poles, trees = [], []
    footprints = [b.footprint.astype(np.float32) for b in buildings]
    leafy = rng.random() < 0.7
    for arm in arms:
        for side in (1, -1):
            edge = (arm.in_edge_m if side > 0 else -arm.out_edge_m) + (PARKING_M if arm.parking else 0)
            for along in np.arange(arm.stop_m + rng.uniform(3, 10), arm.length_m, rng.uniform(18, 28)):
                x, y = arm.point(along, side * (edge + 0.7))
                if road_distance_m(arms, np.array([x, y])) > 0.4:
                    poles.append(Pole(x, y, rng.uniform(6.5, 8.5), 0.1, colour))
            for along in np.arange(arm.stop_m + rng.uniform(2, 12), arm.length_m, rng.uniform(8, 20)):
                x, y = arm.point(along + rng.uniform(-1, 1), side * (edge + rng.uniform(1.4, 5.5)))
                inside = any(cv2.pointPolygonTest(f, (float(x), float(y)), True) > -1.2 for f in footprints)
                if leafy and not inside and rng.random() < 0.6 and road_distance_m(arms, np.array([x, y])) > 1.0:
                    green = rng.uniform(60, 120)
                    tint = (green * rng.uniform(0.35, 0.7), green, green * rng.uniform(0.5, 0.9))
                    trees.append(Tree(x, y, rng.uniform(4.5, 8.5), rng.uniform(1.0, 2.0), tint))
    return tuple(poles), tuple(trees)
