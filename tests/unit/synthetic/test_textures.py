"""Procedural materials: seamless, of the promised strength, and calm from afar."""

from __future__ import annotations

import numpy as np
import pytest

from wibam_core.synthetic import textures
from wibam_core.synthetic.textures import TILE_PX, Maker, Texture, fractal, wrapped

MAKERS = [
    textures.asphalt, textures.grass, textures.gravel, textures.paving, textures.brick, textures.plaster,
    textures.cladding, textures.foliage, textures.anything,
]  # fmt: skip


@pytest.mark.parametrize("coarsest", [4, 32])
def test_noise_is_seamless_and_of_unit_strength(coarsest: int) -> None:
    noise = fractal(np.random.default_rng(1), coarsest, 0.4)
    assert noise.mean() == pytest.approx(0, abs=1e-4)
    assert noise.std() == pytest.approx(1, abs=1e-3)
    inside = np.abs(np.diff(noise, axis=0)).mean()
    assert np.abs(noise[0] - noise[-1]).mean() < 2 * inside
    assert np.abs(noise[:, 0] - noise[:, -1]).mean() < 2 * inside


@pytest.mark.parametrize("maker", MAKERS)
def test_materials_follow_from_the_generator_and_look_like_something(maker: Maker) -> None:
    one, again, other = (maker(np.random.default_rng(seed)) for seed in (3, 3, 4))
    assert one.shape == (TILE_PX, TILE_PX, 3)
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
    assert 5 < one.clip(0, 255).mean() < 250
    assert one.std() > 1


def test_a_texture_repeats_and_is_even_from_afar() -> None:
    tile = np.zeros((64, 64, 3), np.float32)
    tile[:, ::2] = 200
    texture = Texture.of(tile, 6.4)
    u = np.tile(np.arange(16, dtype=np.float32) * np.float32(0.1), (2, 1))
    near = texture.at(u, np.zeros_like(u), np.full_like(u, 0.1))
    assert np.array_equal(near[0, :4, 0], [200, 0, 200, 0])
    assert np.array_equal(near, texture.at(u + np.float32(12.8), np.zeros_like(u), np.full_like(u, 0.1)))
    far = texture.at(u, np.zeros_like(u), np.full_like(u, 0.8))
    assert far.min() == far.max() == 100


def test_wrapping_is_the_remainder() -> None:
    values = np.array([-3.5, 0.0, 2.25, 1000.5], np.float32)
    assert np.allclose(wrapped(values, 2.0), values % 2.0)
