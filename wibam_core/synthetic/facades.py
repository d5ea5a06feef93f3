"""Pictures of walls: houses with windows, doors and shops, and what stands in streets that is no vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.synthetic.layout import Building
from wibam_core.synthetic.raster import Image
from wibam_core.synthetic.textures import (
    Field,
    Maker,
    anything,
    brick,
    cladding,
    foliage,
    gravel,
    plaster,
)

Kind = Literal["house", "container", "hedge", "wall", "kiosk", "sign", "fence", "bins"]

_PX_PER_M = 20.0
_MOST_PX = 640


@dataclass(frozen=True, eq=False)
class Clutter(Building):
    """An upright block that is no house: ``kind`` says what is painted on it."""

    kind: Kind = "container"


@dataclass(frozen=True, eq=False)
class Facade:
    """The picture (h, w, 3) uint8 BGR of a wall, its lowest row at the ground, and px per m."""

    picture: Image
    px_per_m: float


def sample_surfaces(rng: np.random.Generator) -> dict[Kind, list[Field]]:
    """What the walls of one intersection are made of: a few tiles (S, S, 3) of each kind."""
    return {
        kind: [
            cv2.resize(makers[int(rng.integers(len(makers)))](rng), (256, 256), interpolation=cv2.INTER_AREA)
            for _ in range(5 if kind == "house" else 2)
        ]
        for kind, makers in _SURFACES.items()
    }


def facade(building: Building, width_m: float, surfaces: dict[Kind, list[Field]], rng: np.random.Generator) -> Facade:
    """A wall ``width_m`` wide of a building or of clutter."""
    scale = min(_PX_PER_M, _MOST_PX / max(width_m, building.height_m))
    size = (max(8, round(width_m * scale)), max(8, round(building.height_m * scale)))
    kind = building.kind if isinstance(building, Clutter) else "house"
    base = _surface(rng, surfaces[kind], size, scale)
    if kind == "house":
        _windows(rng, base, building.storey_m * scale, scale)
        _ground_floor(rng, base, scale)
    elif kind in ("container", "kiosk", "sign", "bins"):
        _fittings(rng, base, kind)
    if rng.random() < 0.7:  # rain and dust darken the foot, and eaves the top
        foot = np.linspace(rng.uniform(0.75, 1.05), 1, len(base))[::-1] ** 1.5
        base *= foot.astype(np.float32)[:, None, None]
    return Facade(np.asarray(base.clip(0, 255), np.uint8), scale)


_SURFACES: dict[Kind, tuple[Maker, ...]] = {
    "house": (brick, plaster, plaster, cladding),
    "container": (cladding, cladding, plaster),
    "hedge": (foliage,),
    "wall": (brick, plaster, gravel),
    "kiosk": (plaster, cladding, brick),
    "sign": (anything, plaster),
    "fence": (cladding, anything),
    "bins": (plaster, cladding),
}


def _surface(rng: np.random.Generator, tiles: list[Field], size: tuple[int, int], scale: float) -> Field:
    tile = tiles[int(rng.integers(len(tiles)))] * (rng.uniform(0.6, 1.3) * rng.uniform(0.8, 1.2, 3)).astype(np.float32)
    side_px = max(16, round(float(rng.uniform(2.0, 7.0)) * scale))
    small = cv2.resize(tile, (side_px, side_px), interpolation=cv2.INTER_AREA)
    repeats = (-(-size[1] // side_px), -(-size[0] // side_px), 1)
    return np.tile(small, repeats)[: size[1], : size[0]].astype(np.float32)


def _fill(picture: Field, x0: float, y0: float, x1: float, y1: float, colour: NDArray | float) -> None:
    h, w = picture.shape[:2]
    x0, x1 = (int(np.clip(round(x), 0, w)) for x in (x0, x1))
    y0, y1 = (int(np.clip(round(y), 0, h)) for y in (y0, y1))
    picture[y0:y1, x0:x1] = colour


def _glass(rng: np.random.Generator, height: int, width: int) -> Field:
    """A pane (h, w, 3): dark, with sky, blinds or a lamp behind it."""
    dark = rng.uniform(15, 90) * (1 + rng.normal(0, 0.06, 3))
    bright = rng.uniform(60, 230) * (1 + np.array([0.08, 0.0, -0.08]) * rng.normal(1, 0.6))
    share = np.linspace(rng.uniform(0, 0.9), rng.uniform(0, 0.3), height)[:, None]
    if rng.random() < 0.4:  # something opposite is mirrored
        edge = int(rng.integers(0, height + 1))
        share[edge:] *= 0.2
    pane = dark + (bright - dark) * share
    return np.broadcast_to(pane[:, None], (height, width, 3)).astype(np.float32).clip(0, 255)


def _windows(rng: np.random.Generator, wall: Field, storey_px: float, scale: float) -> None:
    height, width = wall.shape[:2]
    column_px = rng.uniform(1.5, 4.5) * scale
    window = rng.uniform(0.3, 0.8) * column_px, rng.uniform(0.3, 0.75) * storey_px
    sill = rng.uniform(0.15, 0.4) * storey_px
    frame = wall.mean(axis=(0, 1)) * rng.uniform(0.4, 1.7)
    thick = max(1, round(rng.uniform(0.02, 0.14) * scale))
    panes = [_glass(rng, max(2, round(window[1])), max(2, round(window[0]))) for _ in range(4)]
    bars, left_out = int(rng.integers(0, 3)), rng.uniform(0, 0.2)
    for bottom in np.arange(height - sill, window[1], -storey_px):
        for left in np.arange(0.5 * (column_px - window[0]), width - window[0], column_px):
            if rng.random() < left_out:
                continue
            x, y = round(left), round(bottom - window[1])
            pane = panes[int(rng.integers(4))]
            _fill(wall, x - thick, y - thick, x + pane.shape[1] + thick, y + len(pane) + thick, frame)
            part = wall[max(y, 0) : y + len(pane), x : x + pane.shape[1]]
            part[:] = pane[len(pane) - len(part) :, : part.shape[1]]
            for bar in range(bars):
                at = x + (bar + 1) * pane.shape[1] / (bars + 1)
                _fill(wall, at, y, at + 1, y + len(pane), frame)
        if rng.random() < 0.15:  # a balcony or a ledge
            _fill(wall, 0, bottom + thick, width, bottom + thick + 0.2 * scale, frame * rng.uniform(0.6, 1.2))


def _ground_floor(rng: np.random.Generator, wall: Field, scale: float) -> None:
    height, width = wall.shape[:2]
    at = rng.uniform(0, 3) * scale
    while at < width - scale:
        kind, wide = rng.random(), rng.uniform(0.9, 5.0) * scale
        tall = (rng.uniform(1.9, 2.9) if kind < 0.8 else rng.uniform(0.5, 1.2)) * scale
        x0, x1 = round(at), round(min(at + wide, width))
        y0 = max(0, round(height - tall))
        if kind < 0.35:
            wall[y0:, x0:x1] = _glass(rng, height - y0, x1 - x0)  # a shop
        elif kind < 0.65:
            door = rng.uniform(20, 220, 3)
            slats = 1 + 0.15 * np.sign(np.sin(np.arange(height - y0) * rng.uniform(0.3, 2.0)))
            wall[y0:, x0:x1] = (door * slats[:, None])[:, None].astype(np.float32)
        if kind < 0.35 and rng.random() < 0.6:
            _fill(wall, x0, y0 - 0.5 * scale, x1, y0, rng.uniform(10, 245, 3))  # its sign
        at += wide + rng.uniform(0.2, 6.0) * scale


def _fittings(rng: np.random.Generator, wall: Field, kind: Kind) -> None:
    """Doors, ribs, panes, writing: what makes a box look like a vehicle's side and yet is none."""
    height, width = wall.shape[:2]
    colour = rng.uniform(5, 250, 3)
    for share in np.sort(rng.uniform(0, 1, int(rng.integers(0, 6)))):
        _fill(wall, share * width, 0, share * width + 1, height, wall.mean(axis=(0, 1)) * rng.uniform(0.3, 1.5))
    if rng.random() < 0.5:
        y = rng.uniform(0.1, 0.7) * height
        _fill(wall, 0, y, width, y + rng.uniform(0.05, 0.3) * height, colour)
    if kind == "kiosk" or rng.random() < 0.25:
        x, y = rng.uniform(0.05, 0.4) * width, rng.uniform(0.1, 0.4) * height
        w, h = max(2, round(rng.uniform(0.2, 0.5) * width)), max(2, round(rng.uniform(0.2, 0.5) * height))
        pane = _glass(rng, h, w)
        part = wall[round(y) : round(y) + h, round(x) : round(x) + w]
        part[:] = pane[: part.shape[0], : part.shape[1]]
    if rng.random() < 0.5:
        _write(rng, wall)


def _write(rng: np.random.Generator, wall: Field) -> None:
    """Marks that look like writing."""
    height, width = wall.shape[:2]
    size = rng.uniform(0.08, 0.35) * height
    x, y = rng.uniform(0.05, 0.4) * width, rng.uniform(0.3, 0.8) * height
    colour = rng.uniform(5, 250, 3)
    for _ in range(int(rng.integers(3, 10))):
        wide = size * rng.uniform(0.4, 0.8)
        _fill(wall, x, y - size, x + 0.25 * wide, y, colour)
        _fill(wall, x, y - size * rng.uniform(0.3, 1.0), x + wide, y - size * rng.uniform(0.0, 0.3), colour)
        x += wide * 1.3
