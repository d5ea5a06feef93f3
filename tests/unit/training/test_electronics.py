"""Spoilt pictures: repeatable, different each time, and nothing in them moves."""

from __future__ import annotations

import cv2
import numpy as np

from wibam_core.training.electronics import degraded


def picture() -> np.ndarray:
    image = np.full((96, 160, 3), 70, np.uint8)
    image[30:66, 50:110] = (200, 180, 170)
    return image


def test_a_generator_gives_the_same_picture_again() -> None:
    one, again, other = (degraded(picture(), np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one.shape == picture().shape
    assert one.dtype == np.uint8
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)


def test_edges_stay_where_they_are() -> None:
    """The contrast along rows and columns is strongest within a pixel or two of the rectangle's sides, mostly."""
    off = []
    for seed in range(60):
        grey = cv2.GaussianBlur(degraded(picture(), np.random.default_rng(seed)), (0, 0), 1.5).mean(axis=2)
        across = np.abs(np.diff(grey[36:60].mean(axis=0)))
        down = np.abs(np.diff(grey[:, 60:100].mean(axis=1)))
        off.append([across[:80].argmax() - 49, across[80:].argmax() + 80 - 109, down[:48].argmax() - 29])
    assert np.abs(np.median(off, axis=0)).max() <= 0.5
    assert np.quantile(np.abs(off), 0.9) <= 2
