"""Paint, glass, lamps, tyres and liveries by where a point lies on a vehicle, and how it is turned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.other_bodies.bodies import Piece, axles_m, upper_m
from benchmarks.other_bodies.catalogue import BodyModel
from wibam_core.road_users import RoadUserClass

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_GLASS, _PLASTIC, _TYRE = (0.03, 0.028, 0.025), (0.022, 0.022, 0.022), (0.018, 0.018, 0.019)
_RIM, _CHROME = (0.33, 0.33, 0.32), (0.5, 0.5, 0.5)
_HEADLAMP, _TAIL_LAMP, _PLATE = (0.75, 0.75, 0.70), (0.03, 0.02, 0.42), (0.65, 0.72, 0.74)
#: Linear BGR of paints and their shares, by what is registered: white, black, greys and blue lead.
_PAINTS = (
    ((0.78, 0.79, 0.80), 0.25), ((0.012, 0.011, 0.011), 0.20), ((0.13, 0.125, 0.12), 0.20), ((0.42, 0.42, 0.42), 0.11),
    ((0.28, 0.10, 0.03), 0.10), ((0.03, 0.02, 0.34), 0.06), ((0.10, 0.16, 0.05), 0.03), ((0.20, 0.36, 0.46), 0.03),
    ((0.03, 0.22, 0.52), 0.02),
)  # fmt: skip


@dataclass(frozen=True)
class Finish:
    """How one vehicle is painted.

    Attributes:
        paint, cargo, accent: linear BGR. livery: number from which the pattern on its sides follows; 0 for none.
        dirt: share of dust towards the sills.
    """

    paint: tuple[float, float, float]
    cargo: tuple[float, float, float]
    accent: tuple[float, float, float]
    livery: int
    dirt: float

    @classmethod
    def sample(cls, rng: np.random.Generator, model: BodyModel) -> Finish:
        weights = np.array([weight for _, weight in _PAINTS])
        drawn = rng.choice(len(_PAINTS), 3, p=weights / weights.sum())
        paint, accent, cargo = (np.clip(np.array(_PAINTS[k][0]) * rng.uniform(0.7, 1.25), 0.01, 0.85) for k in drawn)
        if model.cargo is not None and rng.random() < 0.6:
            cargo = np.full(3, rng.uniform(0.5, 0.8))
        marked = model.vehicle_class is not RoadUserClass.CAR and rng.random() < 0.7
        b, g, r = paint.tolist()
        cb, cg, cr = cargo.tolist()
        ab, ag, ar = accent.tolist()
        livery = int(rng.integers(1, 2**31)) if marked else 0
        return cls((b, g, r), (cb, cg, cr), (ab, ag, ar), livery, rng.uniform(0, 0.5))


@dataclass(frozen=True, eq=False)
class Surface:
    """Of points (N,): albedo (N, 3), share of light that is reflected as in a mirror when met squarely (N,), and light
    of its own (N, 3)."""

    albedo: Array
    mirror: Array
    glow: Array


def surface(model: BodyModel, finish: Finish, points: Array, normals: Array, pieces: Array) -> Surface:
    """What is at points (N, 3) with normals (N, 3) of a vehicle in its own frame, m, that belong to pieces (N,)."""
    n = len(points)
    albedo, mirror, glow = np.empty((n, 3)), np.full(n, 0.02), np.zeros((n, 3))
    albedo[:] = finish.paint
    shell, cargo = pieces == Piece.SHELL, pieces == Piece.CARGO
    mirror[shell] = 0.045
    albedo[cargo] = finish.cargo
    mirror[cargo] = 0.01
    if finish.livery:
        _paint_livery(model, finish, points, normals, (cargo if model.cargo is not None else shell), albedo)
    for kind, colour in ((Piece.CHASSIS, _PLASTIC), (Piece.TYRE, _TYRE), (Piece.RIM, _RIM), (Piece.MIRROR, _PLASTIC)):
        albedo[pieces == kind] = colour
    _paint_shell(model, points, normals, shell, albedo, mirror, glow)
    _paint_cargo_rear(model, points, cargo, albedo)
    _paint_wheels(model, points, pieces, albedo)
    dust = finish.dirt * np.clip(1 - points[:, 2] / (0.5 * model.height_m), 0, 1)[:, None]
    dust = np.where((shell | cargo)[:, None], dust, 0)
    return Surface(albedo * (1 - dust) + dust * [0.17, 0.21, 0.24], mirror * (1 - 0.7 * dust[:, 0]), glow)


def _paint_shell(
    model: BodyModel, points: Array, normals: Array, shell: Mask, albedo: Array, mirror: Array, glow: Array
) -> None:
    x, y, z = points.T
    share, half = 0.5 - x / model.length_m, model.width_m / 2
    height = z / model.height_m
    across = np.abs(y) / half
    top = upper_m(model, x)
    in_front, behind = share < 0.06, share > model.cab_rear - 0.05
    if model.cladding:
        albedo[shell & (z < model.clearance_m + 0.17)] = _PLASTIC
    arches = np.zeros(len(points), bool)
    for axle in axles_m(model):
        off = np.hypot(x - axle, z - model.wheel_m / 2)
        arches |= (off < 0.56 * model.wheel_m) & (across > 0.7)
    albedo[shell & (arches | (normals[:, 2] < -0.6))] = _PLASTIC
    mirror[shell & arches] = 0.0
    nose = float(np.interp(0.02, *np.array(model.top).T))
    grille = in_front & (normals[:, 0] > 0.5)
    albedo[shell & grille & (across < 0.55) & (height > 0.55 * nose) & (height < 0.88 * nose)] = _PLASTIC
    albedo[shell & grille & (across < 0.5) & (np.abs(height - 0.9 * nose) < 0.012)] = _CHROME
    lamp = in_front & (across > 0.58) & (height > 0.80 * nose) & (height < 1.06 * nose)
    albedo[shell & lamp], mirror[shell & lamp], glow[shell & lamp] = _HEADLAMP, 0.08, 0.12
    tail = behind & (across > 0.66) & (height > 0.8 * model.waist) & (height < 1.12 * model.waist)
    tail &= model.cargo is None
    albedo[shell & tail], glow[shell & tail] = _TAIL_LAMP, [0.0, 0.0, 0.05]
    plate = (np.abs(y) < 0.26) & (np.abs(normals[:, 0]) > 0.6)
    front_plate = in_front & (np.abs(z - max(0.42, model.clearance_m + 0.16)) < 0.06)
    rear_plate = behind & (np.abs(height - 0.8 * model.waist) < 0.06 / model.height_m) & (model.cargo is None)
    albedo[shell & plate & (front_plate | rear_plate)] = _PLATE
    if model.bed is not None:
        bed = (share > model.bed[0]) & (share < model.bed[1]) & (normals[:, 2] > 0.5)
        albedo[shell & bed & (across < 0.86)] = _PLASTIC
    for door in (model.screens[0] + 0.03, *model.pillars[:1]):
        seam = (np.abs(share - door) * model.length_m < 0.012) & (across > 0.6) & (z < top - 0.1) & (z > 0.3)
        albedo[shell & seam] *= 0.3
    glass = shell & _glazed(model, points, normals, share, top)
    albedo[glass], mirror[glass], glow[glass] = _GLASS, 0.09, 0.0


def _glazed(model: BodyModel, points: Array, normals: Array, share: Array, top: Array) -> Mask:
    """Where windows are."""
    waist = model.waist * model.height_m
    z = points[:, 2]
    frame = 0.055 * model.height_m
    high = (z > waist + 0.25 * frame) & (z < top - frame) & (top > waist + 2.2 * frame)
    first, last = model.side_glass or (model.screens[0] + 0.015, model.screens[1] - 0.015)
    side = (np.abs(normals[:, 1]) > 0.6) & (share > first) & (share < last)
    for pillar in model.pillars:
        side &= np.abs(share - pillar) * model.length_m > 0.05
    # screens look forwards or backwards, and upwards; they leave the pillars at both sides free
    across = np.abs(points[:, 1]) < 0.5 * model.width_m * (0.5 + 0.5 * model.roof_width) * 0.88
    middle = (model.screens[0] + min(model.screens[1], model.cab_rear)) / 2
    above = (z > waist + 0.25 * frame) & (z < model.height_m * float(max(h for _, h in model.top)) - frame)
    windscreen = (normals[:, 0] > 0.3) & (share < middle)
    rear = (normals[:, 0] < -0.3) & (share > middle) & model.rear_glass
    return np.asarray((high & side) | (above & across & (windscreen | rear)))


def _paint_cargo_rear(model: BodyModel, points: Array, cargo: Mask, albedo: Array) -> None:
    """Doors with a gap, and red lamps below them."""
    rear = cargo & (points[:, 0] < -model.length_m / 2 + 0.02)
    albedo[rear & (np.abs(points[:, 1]) < 0.02)] = _PLASTIC
    if model.cargo is not None:
        low = points[:, 2] < model.cargo.floor_m + 0.22
        albedo[rear & low] = _PLASTIC
        albedo[rear & low & (np.abs(points[:, 1]) > 0.75 * model.width_m / 2)] = _TAIL_LAMP


def _paint_wheels(model: BodyModel, points: Array, pieces: Array, albedo: Array) -> None:
    """Spokes: dark gaps between the hub and the rim."""
    rim = pieces == Piece.RIM
    for axle in axles_m(model):
        x, z = points[:, 0] - axle, points[:, 2] - model.wheel_m / 2
        own = rim & (np.abs(x) < model.wheel_m / 2)
        gap = (np.cos(5 * np.arctan2(z, x)) < -0.2) & (np.hypot(x, z) > 0.12 * model.wheel_m)
        albedo[own & gap] = _PLASTIC


def _paint_livery(model: BodyModel, finish: Finish, points: Array, normals: Array, on: Mask, albedo: Array) -> None:
    """A band, or blocks like large letters, along the sides."""
    rng = np.random.default_rng(finish.livery)
    low, high = np.sort(rng.uniform(0.25, 0.85, 2)) * model.height_m
    start, end = np.sort(rng.uniform(0.05, 0.95, 2))
    share = 0.5 - points[:, 0] / model.length_m
    sides = on & (np.abs(normals[:, 1]) > 0.7) & (points[:, 2] > low) & (points[:, 2] < high)
    if rng.random() < 0.5:
        albedo[sides] = finish.accent
        return
    letters = rng.random(64) < 0.6
    column = (points[:, 0] / (0.35 * (high - low) + 0.1)).astype(np.int64) % 64
    albedo[sides & (share > start) & (share < end) & letters[column]] = finish.accent
