"""Procedural materials: seamless textures with coarser copies for what is far away.

Every texture follows from a generator alone; none is a photograph.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.synthetic.raster import Image

Array = NDArray[np.float64]
Field = NDArray[np.float32]

TILE_PX = 512


@dataclass(frozen=True, eq=False)
class Texture:
    """A seamless square picture of a flat material.

    Attributes:
        levels: (S, S, 3) uint8 BGR pictures of the whole tile, each half as wide as the one before.
        size_m: side of the tile.
    """

    levels: tuple[Image, ...]
    size_m: float

    @classmethod
    def of(cls, tile: Field, size_m: float) -> Texture:
        """From a tile (S, S, 3) in grey levels."""
        levels = [np.asarray(tile.clip(0, 255), dtype=np.uint8)]
        while len(levels[-1]) > 8:
            side = len(levels[-1]) // 2
            levels.append(np.asarray(cv2.resize(levels[-1], (side, side), interpolation=cv2.INTER_AREA), np.uint8))
        return cls(tuple(levels), size_m)

    def at(self, u_m: Field, v_m: Field, pixel_m: Field) -> Image:
        """The colours (h, w, 3) at places (h, w) of the material, where a pixel covers ``pixel_m`` (h, w)."""
        height, width = u_m.shape
        finest = self.size_m / len(self.levels[0])
        level = np.log2(np.maximum(pixel_m / np.float32(finest), 1.0)).round().clip(0, len(self.levels) - 1)
        rows = level.astype(np.int8)
        found = np.zeros((height, width, 3), np.uint8)
        for number in np.unique(rows).tolist():
            there = rows == number
            span = np.flatnonzero(there.any(axis=1))
            band = np.s_[span[0] : span[-1] + 1]
            tile = self.levels[number]
            scale = np.float32(len(tile) / self.size_m)
            side = np.float32(len(tile))
            u, v = (wrapped(m[band] * scale, side) for m in (u_m, v_m))
            seen = cv2.remap(tile, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
            cv2.copyTo(seen, there[band].astype(np.uint8), found[band])
        return found


def wrapped(values: Field, period: np.float32 | float) -> Field:
    """Values modulo a period: some times as fast as the operator is."""
    return np.asarray(values - np.floor(values * np.float32(1 / period)) * np.float32(period), np.float32)


def fractal(rng: np.random.Generator, coarsest: int = 4, fall: float = 0.6, side: int = TILE_PX) -> Field:
    """(side, side) seamless noise of mean 0 and standard deviation 1; each octave is ``fall`` times as strong."""
    total = rng.standard_normal((coarsest, coarsest), dtype=np.float32)
    strength = 1.0
    while len(total) < side:
        cells = 2 * len(total)
        around = np.pad(total, 2, mode="wrap")
        total = cv2.resize(around, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)[4 : 4 + cells, 4 : 4 + cells]
        strength *= fall
        total = total + np.float32(strength) * rng.standard_normal((cells, cells), dtype=np.float32)
    return (total - total.mean()) / np.float32(total.std() + 1e-6)


def tinted(values: Field, colour: Array, strength: float, hue: Field | None = None, hue_sd: float = 0.0) -> Field:
    """(S, S, 3) a colour (3,) made lighter and darker by ``values`` (S, S) of standard deviation 1."""
    tile = np.asarray(colour, np.float32) * (1 + np.float32(strength) * values)[..., None]
    if hue is not None:
        tile = tile * (1 + np.float32(hue_sd) * hue[..., None] * np.array([-1.0, 0.0, 1.0], np.float32))
    return np.asarray(tile, np.float32)


def _speckled(rng: np.random.Generator, values: Field, strength: float) -> Field:
    fine = rng.standard_normal(values.shape, dtype=np.float32)
    return values + np.float32(strength) * fine


def _lines(rng: np.random.Generator, tile: Field, count: int, factor: float, width: int, wander: float) -> None:
    """Multiply wandering lines (cracks, seams, tracks) into a tile."""
    mask = np.zeros(tile.shape[:2], np.uint8)
    for _ in range(count):
        steps = int(rng.integers(4, 24))
        angle = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, wander, steps))
        path = rng.uniform(0, TILE_PX, 2) + np.cumsum(np.stack([np.cos(angle), np.sin(angle)], 1) * 16, axis=0)
        for shift in ((0, 0), (TILE_PX, 0), (0, TILE_PX), (-TILE_PX, 0), (0, -TILE_PX)):
            cv2.polylines(mask, [np.rint(path + shift).astype(np.int32)], False, (255,), width, cv2.LINE_AA)
    tile *= 1 - np.float32(1 - factor) * (mask[..., None].astype(np.float32) / 255)


def asphalt(rng: np.random.Generator) -> Field:
    """Grey, with stains, patches that were mended, cracks and seams of tar."""
    grey = rng.uniform(55, 165)
    colour = grey * (1 + rng.normal(0, 0.035, 3))
    values = _speckled(rng, fractal(rng, 4, rng.uniform(0.5, 0.85)), rng.uniform(0.2, 1.5))
    tile = tinted(values, colour, rng.uniform(0.03, 0.11))
    for _ in range(int(rng.integers(0, 6))):
        x, y = rng.integers(0, TILE_PX - 40, 2)
        w, h = rng.integers(20, 220, 2)
        tile[y : y + h, x : x + w] *= np.float32(rng.uniform(0.72, 1.2))
    _lines(rng, tile, int(rng.integers(0, 14)), rng.uniform(0.45, 0.85), 1, 0.5)
    _lines(rng, tile, int(rng.integers(0, 3)), rng.uniform(0.3, 0.7), 3, 0.05)
    if rng.random() < 0.5:  # tyres leave dark bands along the lane
        band = 1 - rng.uniform(0.05, 0.25) * np.exp(
            -0.5 * ((np.arange(TILE_PX) % 256 - 128) / rng.uniform(15, 50)) ** 2
        )
        tile *= band.astype(np.float32)[:, None, None]
    return tile


def grass(rng: np.random.Generator) -> Field:
    """Lawn, meadow or dry grass, with blades and bare spots."""
    green = np.array([rng.uniform(30, 85), rng.uniform(75, 150), rng.uniform(55, 140)])
    values = _speckled(rng, fractal(rng, int(rng.choice([2, 4, 8])), rng.uniform(0.6, 1.0)), rng.uniform(0.4, 1.5))
    tile = tinted(values, green, rng.uniform(0.08, 0.28), fractal(rng, 4), rng.uniform(0.03, 0.18))
    bare = fractal(rng, 4, 0.7) > rng.uniform(0.8, 3.0)
    tile[bare] = tile[bare] * np.float32(0.35) + np.float32(0.65) * np.array([80, 105, 125], np.float32) * np.float32(
        rng.uniform(0.7, 1.4)
    )
    return tile


def gravel(rng: np.random.Generator) -> Field:
    """Stones, sand or soil."""
    base = rng.uniform(70, 190)
    colour = base * np.array([rng.uniform(0.6, 1.0), rng.uniform(0.8, 1.0), 1.0])
    stones = fractal(rng, int(rng.choice([32, 64, 128])), 0.9)
    values = 0.6 * fractal(rng, 2, 0.6) + np.float32(rng.uniform(0.3, 1.2)) * stones
    return tinted(_speckled(rng, values, 0.4), colour, rng.uniform(0.05, 0.16))


def paving(rng: np.random.Generator) -> Field:
    """Slabs or stones in rows, each with a shade of its own, with joints."""
    rows, columns = int(rng.choice([4, 8, 16, 32])), int(rng.choice([4, 8, 16, 32]))
    joint = rng.uniform(0.7, 1.1)
    shades = rng.normal(0, rng.uniform(0.01, 0.12), (rows, columns)).astype(np.float32)
    tile = np.kron(shades, np.ones((TILE_PX // rows, TILE_PX // columns), np.float32)) + 1
    tile[:: TILE_PX // rows] *= np.float32(joint)
    if rng.random() < 0.5:  # running bond
        for row in range(1, rows, 2):
            part = np.s_[row * TILE_PX // rows : (row + 1) * TILE_PX // rows]
            tile[part] = np.roll(tile[part], TILE_PX // columns // 2, axis=1)
    tile[:, :: TILE_PX // columns] *= np.float32(joint)
    grey = rng.uniform(80, 205)
    colour = grey * np.array([rng.uniform(0.65, 1.05), rng.uniform(0.8, 1.02), 1.0])
    noise = _speckled(rng, fractal(rng, 4, 0.6), 0.5)
    return tinted(noise, colour, rng.uniform(0.02, 0.08)) * tile[..., None]


def brick(rng: np.random.Generator) -> Field:
    """Courses of bricks with mortar."""
    rows, columns = int(rng.choice([16, 32])), int(rng.choice([8, 16]))
    h, w = TILE_PX // rows, TILE_PX // columns
    shades = 1 + rng.normal(0, rng.uniform(0.03, 0.15), (rows, columns, 1)).astype(np.float32)
    red = np.array([rng.uniform(45, 130), rng.uniform(60, 140), rng.uniform(110, 190)], np.float32)
    tile = np.kron(shades, np.ones((h, w, 1), np.float32)) * red
    mortar = np.full(3, rng.uniform(90, 190), np.float32)
    thick = max(1, h // 8)
    for row in range(rows):
        part = tile[row * h : (row + 1) * h]
        for line in range(thick):
            part[:, line::w] = mortar
        if row % 2:
            part[:] = np.roll(part, w // 2, axis=1)
        part[:thick] = mortar
    return tile * (1 + np.float32(0.05) * fractal(rng, 4))[..., None]


def plaster(rng: np.random.Generator) -> Field:
    """Paint or concrete with stains that run down."""
    base = rng.uniform(70, 235)
    colour = (base * (1 + rng.normal(0, 0.10, 3))).clip(20, 245)
    stains = cv2.resize(fractal(rng, 8)[:32], (TILE_PX, TILE_PX), interpolation=cv2.INTER_CUBIC)
    values = fractal(rng, 2, 0.5) + np.float32(rng.uniform(0, 0.8)) * stains
    return tinted(_speckled(rng, values, 0.2), colour, rng.uniform(0.01, 0.08))


def cladding(rng: np.random.Generator) -> Field:
    """Corrugated sheets, planks or panels, upright or lying."""
    colour = rng.uniform(25, 235, 3)
    if rng.random() < 0.7:
        colour = colour.mean() * (1 + rng.normal(0, 0.05, 3))
    waves = int(rng.choice([8, 16, 32, 64]))
    phase = np.arange(TILE_PX) * (waves * 2 * np.pi / TILE_PX)
    profile = np.sin(phase) if rng.random() < 0.5 else np.sign(np.sin(phase))
    tile = tinted(fractal(rng, 4, 0.5), colour, rng.uniform(0.01, 0.07))
    tile *= (1 + rng.uniform(0.03, 0.18) * profile).astype(np.float32)[None, :, None]
    return np.ascontiguousarray(tile.swapaxes(0, 1)) if rng.random() < 0.3 else tile


def foliage(rng: np.random.Generator) -> Field:
    """Leaves in light and shadow."""
    green = np.array([rng.uniform(15, 70), rng.uniform(50, 125), rng.uniform(35, 125)])
    values = fractal(rng, 8, rng.uniform(0.75, 1.05)) + 0.5 * fractal(rng, 64, 0.9)
    tile = tinted(values, green, rng.uniform(0.2, 0.5), fractal(rng, 8), rng.uniform(0.03, 0.2))
    return np.maximum(tile, np.float32(6))


def anything(rng: np.random.Generator) -> Field:
    """Two colours mixed by noise, bars or spots: no material at all."""
    one, two = (rng.uniform(10, 245, 3).astype(np.float32) for _ in range(2))
    share = fractal(rng, int(rng.choice([2, 4, 8, 16])), rng.uniform(0.3, 0.9))
    kind = rng.random()
    if kind < 0.3:
        share = (share > 0).astype(np.float32)
    elif kind < 0.6:
        bars = np.sin(np.arange(TILE_PX) * (int(rng.integers(2, 40)) * 2 * np.pi / TILE_PX)).astype(np.float32)
        share = share * np.float32(0.2) + bars[None]
    weight = (0.5 + 0.3 * share).clip(0, 1)[..., None]
    return np.asarray(one * weight + two * (1 - weight), np.float32)


Maker = Callable[[np.random.Generator], Field]


def sample_texture(rng: np.random.Generator, *makers: Maker, size_m: tuple[float, float] = (6.0, 20.0)) -> Texture:
    """A texture of one of several materials; one in twelve is `anything` instead."""
    maker = anything if rng.random() < 1 / 12 else makers[int(rng.integers(len(makers)))]
    return Texture.of(maker(rng), float(np.exp(rng.uniform(*np.log(size_m)))))
