"""Parametric vehicles: tapered bodies, never boxes, in several styles per class.

The body's full extent equals the size of its box exactly, so the true box is the tight one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from wibam_core.road_users import RoadUserClass
from wibam_core.synthetic.mesh import (
    FRONT,
    FRONT_LEFT,
    FRONT_RIGHT,
    LEFT,
    REAR,
    REAR_LEFT,
    REAR_RIGHT,
    RIGHT,
    Colour,
    Mesh,
    MeshBuilder,
    Patch,
    Split,
    ring,
)

GLASS: Colour = (62, 52, 44)
DARK: Colour = (34, 34, 36)
HEADLIGHT: Colour = (225, 240, 245)
TAILLIGHT: Colour = (40, 30, 190)
PLATE: Colour = (215, 225, 225)

_PAINTS: tuple[tuple[Colour, float], ...] = (
    ((235, 235, 235), 0.22),
    ((38, 38, 40), 0.20),
    ((125, 122, 120), 0.18),
    ((190, 190, 188), 0.12),
    ((130, 70, 35), 0.10),
    ((40, 35, 165), 0.08),
    ((90, 60, 30), 0.03),
    ((60, 95, 55), 0.03),
    ((50, 180, 215), 0.02),
    ((80, 110, 150), 0.02),
)


@dataclass(frozen=True)
class Style:
    """One body style: ranges of length, width and height in m, and shares of the length for bonnet and boot."""

    vehicle_class: RoadUserClass
    name: str
    weight: float
    length_m: tuple[float, float]
    width_m: tuple[float, float]
    height_m: tuple[float, float]
    bonnet: float = 0.25
    boot: float = 0.1
    waist: float = 0.62


STYLES: tuple[Style, ...] = (
    Style(RoadUserClass.CAR, "hatchback", 0.30, (3.65, 4.35), (1.66, 1.82), (1.42, 1.56), 0.24, 0.02, 0.60),
    Style(RoadUserClass.CAR, "saloon", 0.28, (4.40, 4.95), (1.76, 1.90), (1.40, 1.50), 0.26, 0.15, 0.62),
    Style(RoadUserClass.CAR, "estate", 0.12, (4.45, 4.95), (1.76, 1.88), (1.44, 1.54), 0.26, 0.02, 0.61),
    Style(RoadUserClass.CAR, "suv", 0.24, (4.25, 4.95), (1.80, 1.98), (1.60, 1.80), 0.25, 0.02, 0.60),
    Style(RoadUserClass.CAR, "pickup", 0.06, (5.05, 5.45), (1.85, 2.00), (1.76, 1.88), 0.24, 0.34, 0.60),
    Style(RoadUserClass.VAN, "panel", 0.65, (4.90, 6.10), (1.92, 2.08), (1.95, 2.65), 0.15, 0.0, 0.50),
    Style(RoadUserClass.VAN, "minibus", 0.35, (4.70, 5.40), (1.88, 2.00), (1.88, 2.05), 0.16, 0.01, 0.52),
    Style(RoadUserClass.TRUCK, "box", 0.65, (6.2, 9.8), (2.25, 2.52), (2.95, 3.75)),
    Style(RoadUserClass.TRUCK, "tipper", 0.35, (5.8, 8.6), (2.25, 2.50), (2.55, 3.00)),
    Style(RoadUserClass.BUS, "city", 0.70, (10.6, 12.4), (2.48, 2.55), (2.95, 3.20)),
    Style(RoadUserClass.BUS, "midi", 0.30, (8.2, 9.8), (2.38, 2.50), (2.80, 3.05)),
)
_STYLE_BY_NAME = {style.name: style for style in STYLES}

#: Shares of the classes in ordinary traffic.
CLASS_MIX = {RoadUserClass.CAR: 0.74, RoadUserClass.VAN: 0.12, RoadUserClass.TRUCK: 0.08, RoadUserClass.BUS: 0.06}


@dataclass(frozen=True)
class VehicleModel:
    """What one vehicle looks like, whatever it does: style, exact size (m), paint (BGR) and cargo colour."""

    style: str
    length_m: float
    width_m: float
    height_m: float
    paint: Colour
    cargo: Colour

    @property
    def vehicle_class(self) -> RoadUserClass:
        return _STYLE_BY_NAME[self.style].vehicle_class

    @property
    def size_m(self) -> tuple[float, float, float]:
        return self.length_m, self.width_m, self.height_m


def sample_vehicle(rng: np.random.Generator, mix: dict[RoadUserClass, float] | None = None) -> VehicleModel:
    """A vehicle drawn from the shares of classes ``mix`` (default `CLASS_MIX`) and of styles within them."""
    shares = CLASS_MIX if mix is None else mix
    classes = list(shares)
    weights = np.array([shares[c] for c in classes])
    vehicle_class = classes[rng.choice(len(classes), p=weights / weights.sum())]
    styles = [s for s in STYLES if s.vehicle_class is vehicle_class]
    weights = np.array([s.weight for s in styles])
    style = styles[rng.choice(len(styles), p=weights / weights.sum())]
    big = rng.beta(2, 2)  # long vehicles of one style tend to be wide and high
    length, width, height = (
        low + (high - low) * float(np.clip(big + rng.normal(0, 0.15), 0, 1))
        for low, high in (style.length_m, style.width_m, style.height_m)
    )
    paints = [p for p, _ in _PAINTS]
    paint_weights = np.array([w for _, w in _PAINTS])
    paint, cargo = (np.array(paints[rng.choice(len(paints), p=paint_weights)], float) for _ in range(2))
    paint = np.clip(paint * rng.uniform(0.85, 1.15) + rng.normal(0, 6, 3), 8, 250)
    cargo = np.clip(cargo * 0.5 + 110 + rng.normal(0, 8, 3), 8, 250)
    b, g, r = paint.tolist()
    return VehicleModel(style.name, length, width, height, (b, g, r), tuple(cargo.tolist()))


@lru_cache(maxsize=512)
def vehicle_mesh(model: VehicleModel) -> Mesh:
    """The body of a vehicle in its own frame (origin at the centre of its box)."""
    if model.vehicle_class is RoadUserClass.TRUCK:
        return _truck(model)
    if model.vehicle_class is RoadUserClass.BUS:
        return _bus(model)
    return _car(model)


def _shade(colour: Colour, factor: float) -> Colour:
    b, g, r = (min(255.0, c * factor) for c in colour)
    return b, g, r


def _lamps(layer: int, v: tuple[float, float], width: float) -> list[Patch]:
    """Head and tail lights in the outer parts of front and rear and on their chamfers."""
    whole = {FRONT: HEADLIGHT, REAR: TAILLIGHT}
    patches = [Patch(layer, side, u, v, whole[side], 0.5) for side in whole for u in ((0.0, width), (1 - width, 1.0))]
    corner = {FRONT_LEFT: (0.0, 0.7), FRONT_RIGHT: (0.3, 1.0), REAR_LEFT: (0.3, 1.0), REAR_RIGHT: (0.0, 0.7)}
    for side, u in corner.items():
        colour = HEADLIGHT if side in (FRONT_LEFT, FRONT_RIGHT) else TAILLIGHT
        patches.append(Patch(layer, side, u, v, colour, 0.5))
    return patches


def _wheels(builder: MeshBuilder, xs: tuple[float, ...], half_width: float, radius: float) -> None:
    for x in xs:
        for side in (1, -1):
            builder.add_wheel(x, side * half_width, radius, 0.24)


def _car(model: VehicleModel) -> Mesh:
    """Cars and vans: a chamfered lower body, and a narrower, shorter cabin on it."""
    style = _STYLE_BY_NAME[model.style]
    length, width, height = model.size_m
    van = model.vehicle_class is RoadUserClass.VAN
    front, rear, half = length / 2, -length / 2, width / 2
    waist = style.waist * height
    bumper = 0.30 * height if van else 0.36 * height
    clearance = 0.13 * height if not van else 0.11 * height
    builder = MeshBuilder()
    nose = waist - (0.02 if van else 0.08) * height
    body = builder.add_loft(
        [
            ring(front - 0.16, rear + 0.18, 0.91 * half, 0.22, (clearance, clearance)),
            ring(front, rear, half, 0.26, (bumper, bumper)),
            ring(front - 0.30, rear + 0.10, 0.94 * half, 0.34, (nose, waist)),
        ],
        [_shade(model.paint, 0.72), model.paint, model.paint],
        [
            *_lamps(1, (0.30, 0.80), 0.24),
            Patch(1, FRONT, (0.30, 0.70), (0.05, 0.6), DARK),
            Patch(0, FRONT, (0.38, 0.62), (0.55, 0.95), PLATE),
            Patch(1, REAR, (0.36, 0.64), (0.1, 0.4), PLATE),
        ],
    )
    base_front = front - style.bonnet * length
    base_rear = rear + style.boot * length + (0.04 if van else 0.14)
    screen = (0.50 if van else 0.85) * (height - waist) * (0.9 if model.style == "suv" else 1.1)
    back = (0.08 if van or model.style == "pickup" else 0.35 if style.boot < 0.1 else 0.95) * (height - waist)
    roof = 0.86 if van else 0.76
    cabin = builder.add_loft(
        [
            ring(base_front, base_rear, 0.92 * half, 0.12, (waist - 0.03 * height, waist)),
            ring(base_front - screen, base_rear + back, roof * half, 0.14, (height * 0.975, height)),
        ],
        [model.paint, _shade(model.paint, 0.97)],
        _car_windows(model.style),
    )
    radius = 0.32 + 0.02 * (length - 4.0) if not van else 0.35
    _wheels(builder, (front - 0.19 * length, rear + 0.19 * length), 0.985 * half, radius)
    return builder.build(model.size_m, Split(2, waist - 0.02 * height, body, cabin))


def _car_windows(style: str) -> list[Patch]:
    high = (0.12, 0.86)
    windows = [Patch(0, FRONT, (0.04, 0.96), (0.08, 0.92), GLASS), Patch(0, FRONT_LEFT, (0.0, 0.4), high, GLASS)]
    windows.append(Patch(0, FRONT_RIGHT, (0.6, 1.0), high, GLASS))
    if style != "panel":
        windows.append(Patch(0, REAR, (0.08, 0.92), high, GLASS))
    spans = {
        "panel": [(0.02, 0.26)],
        "pickup": [(0.05, 0.47), (0.53, 0.93)],
        "minibus": [(0.02, 0.30), (0.33, 0.62), (0.65, 0.95)],
        "saloon": [(0.06, 0.49), (0.53, 0.92)],
    }.get(style, [(0.04, 0.38), (0.42, 0.72), (0.76, 0.95)])
    for start, end in spans:  # from the front
        windows.append(Patch(0, LEFT, (start, end), high, GLASS))
        windows.append(Patch(0, RIGHT, (1 - end, 1 - start), high, GLASS))
    return windows


def _truck(model: VehicleModel) -> Mesh:
    """A cab, and behind it a cargo box (or a low tipper body) on a chassis."""
    length, width, height = model.size_m
    front, rear, half = length / 2, -length / 2, width / 2
    box = model.style == "box"
    cab_length = min(2.3, 0.30 * length)
    cab_top = 0.80 * height if box else height
    split = front - cab_length - 0.12
    builder = MeshBuilder()
    cab = builder.add_loft(
        [
            ring(front - 0.10, front - cab_length, 0.92 * half, 0.15, (0.38, 0.38)),
            ring(front, front - cab_length, 0.97 * half, 0.20, (1.05, 1.05)),
            ring(front - 0.08, front - cab_length, 0.96 * half, 0.20, (0.55 * cab_top, 0.55 * cab_top)),
            ring(front - 0.45, front - cab_length + 0.05, 0.86 * half, 0.22, (cab_top - 0.06, cab_top)),
        ],
        [_shade(model.paint, 0.55), model.paint, model.paint, _shade(model.paint, 0.97)],
        [
            *(Patch(0, FRONT, u, (0.4, 0.85), HEADLIGHT, 0.5) for u in ((0.0, 0.25), (0.75, 1.0))),
            Patch(1, FRONT, (0.15, 0.85), (0.1, 0.8), DARK),
            Patch(2, FRONT, (0.04, 0.96), (0.10, 0.85), GLASS),
            Patch(2, FRONT_LEFT, (0.0, 0.5), (0.12, 0.83), GLASS),
            Patch(2, FRONT_RIGHT, (0.5, 1.0), (0.12, 0.83), GLASS),
            Patch(2, LEFT, (0.05, 0.62), (0.12, 0.80), GLASS),
            Patch(2, RIGHT, (0.38, 0.95), (0.12, 0.80), GLASS),
        ],
    )
    floor, top = (0.95, height) if box else (0.95, 0.66 * height)
    taper = 0.985 if box else 1.0
    cargo = builder.add_loft(
        [
            ring(split, rear, (0.985 if box else 0.90) * half, 0.04, (floor, floor)),
            ring(split, rear, half, 0.05, (floor + 0.35 * (top - floor),) * 2),
            ring(split - 0.03, rear + 0.03, taper * half, 0.06, (top, top)),
        ],
        [_shade(model.cargo, 0.85), model.cargo, model.cargo if box else (70, 90, 110)],
        [
            Patch(1, REAR, (0.485, 0.515), (0.0, 1.0), DARK),
            Patch(0, REAR, (0.04, 0.16), (0.05, 0.35), TAILLIGHT, 0.5),
            Patch(0, REAR, (0.84, 0.96), (0.05, 0.35), TAILLIGHT, 0.5),
            *(Patch(1, side, (0.2, 0.8), (0.25, 0.7), model.paint) for side in (LEFT, RIGHT) if box),
        ],
    )
    chassis = builder.add_loft(
        [ring(split, rear + 0.15, 0.45 * half, 0.05, (z, z)) for z in (0.45, floor)], [DARK, DARK]
    )
    axles = (front - 0.5 * cab_length, rear + 0.2 * length)
    _wheels(builder, (*axles, axles[1] + 1.1) if length > 8 else axles, 0.96 * half, 0.48)
    return builder.build(model.size_m, Split(0, split + 0.05, Split(2, floor, chassis, cargo), cab))


def _bus(model: VehicleModel) -> Mesh:
    length, width, height = model.size_m
    front, rear, half = length / 2, -length / 2, width / 2
    window, eaves = 0.42 * height, 0.82 * height
    builder = MeshBuilder()
    panes = max(4, round(length / 1.7))
    windows = []
    for i in range(panes):
        start, end = (i + 0.06) / panes, (i + 0.94) / panes
        windows.append(Patch(2, LEFT, (start, end), (0.08, 0.92), GLASS))
        windows.append(Patch(2, RIGHT, (start, end), (0.08, 0.92), GLASS))
    body = builder.add_loft(
        [
            ring(front - 0.12, rear + 0.12, 0.95 * half, 0.20, (0.28, 0.28)),
            ring(front, rear, half, 0.25, (0.85, 0.85)),
            ring(front - 0.02, rear + 0.02, half, 0.26, (window, window)),
            ring(front - 0.14, rear + 0.06, 0.97 * half, 0.28, (eaves, eaves)),
            ring(front - 0.35, rear + 0.25, 0.88 * half, 0.35, (height, height)),
        ],
        [_shade(model.paint, 0.75), model.paint, model.paint, model.cargo, _shade(model.cargo, 0.98)],
        [
            *_lamps(0, (0.35, 0.85), 0.18),
            *windows,
            Patch(2, FRONT, (0.03, 0.97), (-0.0, 0.95), GLASS),
            Patch(2, FRONT_LEFT, (0.1, 0.9), (0.0, 0.95), GLASS),
            Patch(2, FRONT_RIGHT, (0.1, 0.9), (0.0, 0.95), GLASS),
            Patch(2, REAR, (0.15, 0.85), (0.25, 0.9), GLASS),
            Patch(3, FRONT, (0.2, 0.8), (0.15, 0.75), (40, 150, 230), 0.7),
            Patch(1, REAR, (0.2, 0.8), (0.1, 0.7), DARK),
            Patch(1, RIGHT, (0.80, 0.90), (0.0, 1.0), GLASS),
            Patch(1, RIGHT, (0.42, 0.52), (0.0, 1.0), GLASS),
        ],
    )
    _wheels(builder, (front - 2.4, rear + 0.27 * length), 0.965 * half, 0.47)
    return builder.build(model.size_m, body)
