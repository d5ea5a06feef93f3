"""Vehicles of more shapes and looks than simulated traffic has, for training views.

Proportions, colours, trim and lamps are drawn one by one, so that no two vehicles are alike. As with
`wibam_core.synthetic.vehicles`, a body's full extent is its box exactly.
"""

from __future__ import annotations

import zlib
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
from wibam_core.synthetic.vehicles import DARK, PLATE, VehicleModel

_CAR, _VAN, _TRUCK, _BUS = RoadUserClass.CAR, RoadUserClass.VAN, RoadUserClass.TRUCK, RoadUserClass.BUS

#: Shape -> class, weight within its class, and ranges of length, width and height, m.
_SHAPES: dict[str, tuple[RoadUserClass, float, tuple[float, float], tuple[float, float], tuple[float, float]]] = {
    "small": (_CAR, 0.18, (3.4, 4.2), (1.55, 1.82), (1.38, 1.62)),
    "three-box": (_CAR, 0.28, (4.2, 5.2), (1.70, 1.95), (1.36, 1.54)),
    "two-box": (_CAR, 0.20, (4.0, 4.95), (1.70, 1.92), (1.40, 1.58)),
    "tall": (_CAR, 0.24, (4.1, 5.15), (1.76, 2.05), (1.55, 1.95)),
    "open-bed": (_CAR, 0.10, (4.9, 6.0), (1.80, 2.08), (1.68, 2.0)),
    "people-carrier": (_VAN, 0.35, (4.4, 5.4), (1.78, 2.05), (1.70, 2.1)),
    "panel-van": (_VAN, 0.65, (4.3, 7.2), (1.80, 2.15), (1.85, 2.9)),
    "box-truck": (_TRUCK, 0.45, (5.4, 10.5), (2.0, 2.6), (2.5, 3.9)),
    "flat-bed": (_TRUCK, 0.2, (5.4, 10.0), (1.95, 2.55), (2.1, 3.0)),
    "tanker": (_TRUCK, 0.15, (6.5, 10.5), (2.2, 2.55), (2.7, 3.5)),
    "articulated": (_TRUCK, 0.2, (11.0, 16.8), (2.4, 2.6), (3.2, 4.0)),
    "coach": (_BUS, 0.5, (8.5, 14.0), (2.35, 2.6), (3.0, 3.9)),
    "city-bus": (_BUS, 0.5, (6.5, 13.5), (2.2, 2.58), (2.6, 3.3)),
}


@dataclass(frozen=True)
class VariedModel(VehicleModel):
    """A vehicle whose ``style`` is one of this module's shapes."""

    @property
    def vehicle_class(self) -> RoadUserClass:
        return _SHAPES[self.style][0]


def sample_varied(rng: np.random.Generator, mix: dict[RoadUserClass, float]) -> VariedModel:
    """A vehicle drawn from the shares of classes ``mix``."""
    classes = list(mix)
    weights = np.array([mix[c] for c in classes])
    chosen = classes[int(rng.choice(len(classes), p=weights / weights.sum()))]
    shapes = [name for name, shape in _SHAPES.items() if shape[0] is chosen]
    weights = np.array([_SHAPES[name][1] for name in shapes])
    name = shapes[int(rng.choice(len(shapes), p=weights / weights.sum()))]
    big = rng.beta(1.5, 1.5)
    length, width, height = (
        low + (high - low) * float(np.clip(big + rng.normal(0, 0.22), 0, 1)) for low, high in _SHAPES[name][2:]
    )
    return VariedModel(name, length, width, height, _paint(rng), _paint(rng))


def _paint(rng: np.random.Generator) -> Colour:
    kind = rng.random()
    if kind < 0.65:  # white, silver, grey, black
        grey = rng.choice([rng.uniform(205, 250), rng.uniform(90, 205), rng.uniform(8, 60)], p=[0.36, 0.3, 0.34])
        colour = grey * (1 + rng.normal(0, 0.035, 3))
    else:
        hue, value = rng.uniform(0, 6), rng.uniform(50, 240)
        pale = rng.uniform(0.05, 0.75)
        ramp = np.array([abs(hue - 3) - 1, 2 - abs(hue - 2), 2 - abs(hue - 4)]).clip(0, 1)
        colour = value * (pale + (1 - pale) * ramp[::-1])
    b, g, r = colour.clip(4, 252).tolist()
    return b, g, r


def varied_mesh(model: VariedModel) -> Mesh:
    """The body in its own frame (origin at the centre of its box); the same model gives the same body."""
    return _mesh(model)


@lru_cache(maxsize=512)
def _mesh(model: VariedModel) -> Mesh:
    rng = np.random.default_rng(zlib.crc32(repr(model).encode()))
    if model.vehicle_class is _TRUCK:
        return _truck(model, rng)
    if model.vehicle_class is _BUS:
        return _bus(model, rng)
    return _car(model, rng)


def _times(colour: Colour, factor: float) -> Colour:
    b, g, r = (min(255.0, c * factor) for c in colour)
    return b, g, r


def _glass_colour(rng: np.random.Generator) -> Colour:
    grey = rng.uniform(14, 90)
    b, g, r = (grey * (1 + rng.normal(0, 0.08, 3))).tolist()
    return b, g, r


def _lamps(layer: int, rng: np.random.Generator) -> list[Patch]:
    """Head and tail lamps of one vehicle, on or off."""
    low = rng.uniform(0.25, 0.55)
    v = (low, low + rng.uniform(0.2, 0.42))
    wide, lit = rng.uniform(0.12, 0.34), rng.random() < 0.35
    front: Colour = (250.0, 252.0, 255.0) if lit else (rng.uniform(120, 230),) * 3
    rear: Colour = (20.0, 20.0, 250.0) if rng.random() < 0.3 else (rng.uniform(15, 60), 25.0, rng.uniform(90, 210))
    patches = []
    for side, colour, corners in ((FRONT, front, (FRONT_LEFT, FRONT_RIGHT)), (REAR, rear, (REAR_RIGHT, REAR_LEFT))):
        patches += [Patch(layer, side, u, v, colour, 0.6) for u in ((0.0, wide), (1 - wide, 1.0))]
        patches.append(Patch(layer, corners[0], (0.0, 0.75), v, colour, 0.6))
        patches.append(Patch(layer, corners[1], (0.25, 1.0), v, colour, 0.6))
    return patches


def _seams(layer: int, rng: np.random.Generator, paint: Colour, places: tuple[float, ...]) -> list[Patch]:
    """Gaps between doors, handles and a strip along the sides; places are shares of the length from the front."""
    dark = _times(paint, 0.45)
    found = []
    for place in places:
        for side, at in ((LEFT, place), (RIGHT, 1 - place)):
            found.append(Patch(layer, side, (at - 0.004, at + 0.004), (0.02, 1.0), dark))
            found.append(Patch(layer, side, (at + 0.01, at + 0.045), (0.72, 0.78), dark))
    if rng.random() < 0.4:
        strip = DARK if rng.random() < 0.6 else _paint(rng)
        v = rng.uniform(0.02, 0.5)
        found += [Patch(layer, side, (0.02, 0.98), (v, v + rng.uniform(0.05, 0.2)), strip) for side in (LEFT, RIGHT)]
    return found


def _wheels(builder: MeshBuilder, xs: tuple[float, ...], half_width: float, radius: float) -> None:
    for x in xs:
        for side in (1, -1):
            builder.add_wheel(x, side * half_width, radius, 0.22)


def _panes(count: int, first: float, last: float, gap: float) -> list[tuple[float, float]]:
    width = (last - first) / count
    return [(first + i * width + gap / 2, first + (i + 1) * width - gap / 2) for i in range(count)]


def _car(model: VariedModel, rng: np.random.Generator) -> Mesh:
    """Cars and vans: a lower body with a bonnet, a cabin, and for open beds a low rear."""
    length, width, height = model.size_m
    van = model.vehicle_class is _VAN
    panel, bed = model.style == "panel-van", model.style == "open-bed"
    front, rear, half = length / 2, -length / 2, width / 2
    waist = height * (rng.uniform(0.42, 0.56) if van else rng.uniform(0.54, 0.68))
    bumper = height * rng.uniform(0.22, 0.40)
    bonnet = length * (rng.uniform(0.03, 0.20) if van else rng.uniform(0.18, 0.32))
    boot = length * {"three-box": rng.uniform(0.10, 0.2), "open-bed": rng.uniform(0.28, 0.42)}.get(model.style, 0.01)
    droop = height * rng.uniform(0.0, 0.13)
    taper = rng.uniform(0.82, 0.97)
    glass = _glass_colour(rng)
    lower = _times(model.paint, rng.uniform(0.5, 1.0)) if rng.random() < 0.6 else DARK
    two_tone = model.cargo if rng.random() < 0.12 else model.paint
    builder = MeshBuilder()
    body = builder.add_loft(
        [
            ring(
                front - rng.uniform(0.05, 0.25), rear + rng.uniform(0.05, 0.25), 0.92 * half, 0.2, (0.1 * height,) * 2
            ),
            ring(front, rear, half, rng.uniform(0.12, 0.4), (bumper, bumper)),
            ring(
                front - rng.uniform(0.05, 0.4), rear + 0.08, rng.uniform(0.92, 0.98) * half, 0.3, (waist - droop, waist)
            ),
        ],
        [lower, two_tone, model.paint],
        [
            *_lamps(1, rng),
            *_seams(1, rng, model.paint, (0.32, 0.52) if not van else (0.2, 0.5)),
            Patch(1, FRONT, (0.25, 0.75), (0.02, rng.uniform(0.3, 0.75)), DARK),
            Patch(0, FRONT, (0.38, 0.62), (0.55, 0.95), PLATE),
            Patch(1, REAR, (0.36, 0.64), (0.1, rng.uniform(0.3, 0.5)), PLATE),
        ],
    )
    rise = height - waist
    screen = rise * rng.uniform(0.35, 1.6)
    back = rise * (rng.uniform(0.05, 0.25) if van or bed else rng.uniform(0.15, 1.2))
    base_front, base_rear = front - bonnet, rear + boot + 0.06
    screen = min(screen, 0.45 * (base_front - base_rear - back))
    high = (rng.uniform(0.08, 0.18), rng.uniform(0.8, 0.92))
    windows = [Patch(0, FRONT, (0.04, 0.96), (0.06, 0.94), glass), Patch(0, FRONT_LEFT, (0.0, 0.5), high, glass)]
    windows.append(Patch(0, FRONT_RIGHT, (0.5, 1.0), high, glass))
    if not panel or rng.random() < 0.5:
        windows.append(Patch(0, REAR, (0.08, 0.92), high, glass))
    glazed = rng.uniform(0.2, 0.34) if panel and rng.random() < 0.75 else rng.uniform(0.86, 0.97)
    panes = 1 if glazed < 0.4 or (bed and rng.random() < 0.4) else int(rng.integers(2, 5))
    for start, end in _panes(panes, 0.03, glazed, rng.uniform(0.02, 0.05)):
        windows += [Patch(0, LEFT, (start, end), high, glass), Patch(0, RIGHT, (1 - end, 1 - start), high, glass)]
    if panel and glazed < 0.4 and rng.random() < 0.5:  # writing on the sides
        u, v, colour = rng.uniform(0.38, 0.5), rng.uniform(0.2, 0.4), _paint(rng)
        windows += [Patch(0, side, (u, u + 0.35), (v, v + 0.35), colour) for side in (LEFT, RIGHT)]
    roof = _times(model.paint, rng.uniform(0.9, 1.0)) if rng.random() < 0.8 else glass
    top_front, top_rear = base_front - screen, base_rear + back
    cabin = builder.add_loft(
        [
            ring(base_front, base_rear, 0.93 * half, 0.1, (waist - min(droop, 0.04 * height), waist)),
            ring(top_front, top_rear, taper * 0.95 * half, 0.14, (height * rng.uniform(0.95, 1.0), height)),
        ],
        [model.paint, roof],
        windows,
    )
    radius = rng.uniform(0.28, 0.42)
    _wheels(
        builder,
        (front - rng.uniform(0.16, 0.21) * length, rear + rng.uniform(0.15, 0.22) * length),
        0.985 * half,
        radius,
    )
    return builder.build(model.size_m, Split(2, waist - 0.02 * height, body, cabin))


def _cab(builder: MeshBuilder, model: VariedModel, rng: np.random.Generator, back: float, top: float) -> int:
    front, half = model.length_m / 2, model.width_m / 2
    glass = _glass_colour(rng)
    low = rng.uniform(0.30, 0.45)
    sill = top * rng.uniform(0.42, 0.6)
    nose = rng.uniform(0.0, 0.25) if rng.random() < 0.75 else rng.uniform(0.4, 0.9)
    lit: Colour = (245.0, 250.0, 255.0) if rng.random() < 0.35 else (rng.uniform(130, 220),) * 3
    return builder.add_loft(
        [
            ring(front - 0.08, back, 0.93 * half, 0.15, (low, low)),
            ring(front, back, 0.97 * half, 0.2, (0.5 * (low + sill),) * 2),
            ring(front - nose, back, 0.96 * half, 0.2, (sill, sill)),
            ring(front - nose - rng.uniform(0.1, 0.5), back + 0.03, 0.88 * half, 0.2, (top - 0.05, top)),
        ],
        [_times(model.paint, rng.uniform(0.4, 1)), model.paint, model.paint, _times(model.paint, 0.97)],
        [
            *(Patch(0, FRONT, u, (0.35, 0.85), lit, 0.6) for u in ((0.0, 0.22), (0.78, 1.0))),
            Patch(1, FRONT, (0.12, 0.88), (0.1, rng.uniform(0.5, 0.95)), DARK),
            Patch(2, FRONT, (0.04, 0.96), (0.08, 0.88), glass),
            Patch(2, FRONT_LEFT, (0.0, 0.5), (0.1, 0.85), glass),
            Patch(2, FRONT_RIGHT, (0.5, 1.0), (0.1, 0.85), glass),
            Patch(2, LEFT, (0.05, 0.7), (0.1, 0.82), glass),
            Patch(2, RIGHT, (0.3, 0.95), (0.1, 0.82), glass),
        ],
    )


def _truck(model: VariedModel, rng: np.random.Generator) -> Mesh:
    """A cab and what it carries or pulls: a box, a tank, or a flat bed with or without a load."""
    length, _, height = model.size_m
    front, rear, half = length / 2, -length / 2, model.width_m / 2
    flat, tank = model.style == "flat-bed", model.style == "tanker"
    cab_length = min(rng.uniform(1.6, 2.8), 0.42 * length)
    gap = rng.uniform(0.05, 0.3) if model.style != "articulated" else rng.uniform(0.2, 0.9)
    split = front - cab_length - gap
    builder = MeshBuilder()
    cab_top = height if flat else height * rng.uniform(0.68, 1.0)
    cab = _cab(builder, model, rng, front - cab_length, cab_top)
    floor = rng.uniform(0.8, 1.25)
    top = floor + rng.uniform(0.25, 0.9) * (height - floor) if flat else height
    sides = 0.8 * half if tank else half
    shoulder = half if tank else rng.uniform(0.97, 1.0) * half
    colour = model.paint if rng.random() < 0.3 else model.cargo
    chamfer = 0.35 if tank else 0.04
    signs = []
    if not tank and rng.random() < 0.5:
        u, v, ink = rng.uniform(0.05, 0.4), rng.uniform(0.1, 0.5), _paint(rng)
        signs = [Patch(1, s, (u, u + rng.uniform(0.2, 0.5)), (v, v + 0.35), ink) for s in (LEFT, RIGHT)]
    ribs = int(rng.integers(0, 9))
    for at in np.linspace(0.05, 0.95, ribs):
        signs += [Patch(1, s, (at - 0.004, at + 0.004), (0.0, 1.0), _times(colour, 0.7)) for s in (LEFT, RIGHT)]
    cargo = builder.add_loft(
        [
            ring(split, rear, sides, chamfer, (floor, floor)),
            ring(split, rear, shoulder, chamfer, (floor + rng.uniform(0.1, 0.5) * (top - floor),) * 2),
            ring(split - 0.03, rear + 0.03, (0.62 if tank else 0.99) * half, chamfer, (top, top)),
        ],
        [_times(colour, rng.uniform(0.5, 1)), colour, _paint(rng) if flat else _times(colour, 0.98)],
        [
            Patch(1, REAR, (0.485, 0.515), (0.0, 1.0), DARK),
            *(Patch(0, REAR, u, (0.05, 0.45), (30.0, 25.0, 190.0), 0.5) for u in ((0.03, 0.15), (0.85, 0.97))),
            *signs,
        ],
    )
    skirt = half * (0.95 if rng.random() < 0.35 else 0.5)
    under = rng.uniform(0.35, 0.55)
    chassis = builder.add_loft(
        [ring(split, rear + 0.15, skirt, 0.05, (z, z)) for z in (under, floor)],
        [DARK if rng.random() < 0.7 else _times(colour, 0.7), DARK],
    )
    last = rear + rng.uniform(0.12, 0.24) * min(length, 9.0)
    axles = [front - rng.uniform(0.45, 0.65) * cab_length, last]
    axles += [last + 1.2] if length > 8 else []
    axles += [split - 1.0, last + 2.4] if length > 11 else []
    _wheels(builder, tuple(axles), 0.97 * half, rng.uniform(0.4, 0.52))
    return builder.build(model.size_m, Split(0, split + 0.03, Split(2, floor, chassis, cargo), cab))


def _bus(model: VariedModel, rng: np.random.Generator) -> Mesh:
    length, _, height = model.size_m
    front, rear, half = length / 2, -length / 2, model.width_m / 2
    sill, eaves = rng.uniform(0.32, 0.52) * height, rng.uniform(0.76, 0.9) * height
    skirt = rng.uniform(0.22, 0.3) * height
    glass = _glass_colour(rng)
    builder = MeshBuilder()
    windows = []
    for start, end in _panes(int(rng.integers(3, 10)), 0.01, 0.99, rng.uniform(0.004, 0.03)):
        windows += [Patch(2, side, (start, end), (0.06, 0.94), glass) for side in (LEFT, RIGHT)]
    if rng.random() < 0.5:
        colour, u = _paint(rng), rng.uniform(0.1, 0.5)
        windows += [Patch(1, side, (u, u + 0.4), (0.1, 0.9), colour) for side in (LEFT, RIGHT)]
    for door in rng.uniform(0.05, 0.9, int(rng.integers(0, 4))):
        windows.append(Patch(1, RIGHT, (door, door + 0.09), (0.0, 1.0), glass))
    body = builder.add_loft(
        [
            ring(front - 0.1, rear + 0.1, 0.95 * half, 0.2, (0.28, 0.28)),
            ring(front, rear, half, rng.uniform(0.1, 0.4), (skirt, skirt)),
            ring(front - 0.02, rear + 0.02, half, 0.25, (sill, sill)),
            ring(front - rng.uniform(0.05, 0.5), rear + 0.06, 0.98 * half, 0.28, (eaves, eaves)),
            ring(front - rng.uniform(0.5, 0.8), rear + 0.25, rng.uniform(0.8, 0.95) * half, 0.3, (height, height)),
        ],
        [
            _times(model.paint, rng.uniform(0.5, 1)), model.paint, model.paint if rng.random() < 0.5 else glass,
            model.cargo if rng.random() < 0.5 else model.paint, _times(model.paint, rng.uniform(0.85, 1)),
        ],
        [
            *_lamps(1, rng),
            *windows,
            Patch(2, FRONT, (0.03, 0.97), (0.0, 0.95), glass),
            Patch(2, FRONT_LEFT, (0.1, 0.9), (0.0, 0.95), glass),
            Patch(2, FRONT_RIGHT, (0.1, 0.9), (0.0, 0.95), glass),
            Patch(2, REAR, (0.12, 0.88), (0.2, 0.9), glass),
            Patch(3, FRONT, (0.2, 0.8), (0.15, 0.75), (rng.uniform(20, 80), 140.0, 230.0), 0.7),
            Patch(1, REAR, (0.2, 0.8), (0.1, 0.7), DARK),
        ],
    )  # fmt: skip
    axles = (front - rng.uniform(1.8, 2.8), rear + rng.uniform(0.2, 0.3) * length)
    _wheels(builder, axles, 0.97 * half, rng.uniform(0.42, 0.5))
    return builder.build(model.size_m, body)
