"""What cameras, weather and recorders do to pictures, for training: all drawn from an explicit generator."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Pixels = NDArray[np.float32]


def degraded(image: Image, rng: np.random.Generator, noise: bool = True) -> Image:
    """The picture (H, W, 3) of another camera, at another hour: BGR uint8, the same size, nothing moved.

    Veil and uneven light, exposure, colours, resolution, blur, noise, sharpening and compression, each now and then.
    Without ``noise`` all else is as it would be with it: what is left of a still background after many frames.
    """
    pixels = _lit(image.astype(np.float32), rng)
    pixels = _exposed(pixels, rng)
    pixels = _blurred(pixels, rng)
    with_noise = _noisy(pixels, rng)
    pixels = with_noise if noise else pixels
    if rng.random() < 0.35:  # halos
        soft = cv2.GaussianBlur(pixels, (0, 0), float(rng.uniform(0.6, 1.8)))
        pixels = pixels + np.float32(rng.uniform(0.3, 1.8)) * (pixels - soft)
    result = np.asarray(pixels.clip(0, 255), np.uint8)
    if rng.random() < 0.5:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(15, 85))]
        result = np.asarray(cv2.imdecode(cv2.imencode(".jpg", result, quality)[1], cv2.IMREAD_COLOR), np.uint8)
    return result


def _lit(pixels: Pixels, rng: np.random.Generator) -> Pixels:
    """Uneven light over the picture, dark corners, and a veil of haze."""
    height, width = pixels.shape[:2]
    if rng.random() < 0.5:
        cells = rng.normal(1, rng.uniform(0.02, 0.15), (3, 4)).astype(np.float32)
        pixels = pixels * cv2.resize(cells, (width, height), interpolation=cv2.INTER_CUBIC)[..., None]
    if rng.random() < 0.2:
        x, y = np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32)[:, None]
        pixels = pixels * (1 - np.float32(rng.uniform(0.05, 0.3)) * (x**2 + y**2))[..., None]
    if rng.random() < 0.2:
        far = np.linspace(rng.uniform(0.1, 0.6), rng.uniform(0, 0.1), height, dtype=np.float32)[:, None, None]
        pixels = pixels * (1 - far) + np.float32(rng.uniform(110, 230)) * far
    return np.asarray(pixels, np.float32)


def _exposed(pixels: Pixels, rng: np.random.Generator) -> Pixels:
    """Gain, tone curve, cast and saturation; one in twelve is a dusk."""
    gain = np.exp(rng.normal(0.0, 0.25)) * np.exp(rng.normal(0.0, 0.06, 3))
    gamma = float(np.exp(rng.normal(0.0, 0.22)))
    if rng.random() < 1 / 12:
        gain = gain * rng.uniform(0.2, 0.5) * np.array([rng.uniform(0.6, 1.2), 1.0, rng.uniform(0.8, 1.4)])
    levels = np.arange(256)[:, None] / 255.0
    curve = (levels * gain).clip(0, 1) ** gamma
    if rng.random() < 0.4:  # contrast about the middle
        curve = 0.5 + (curve - 0.5) * np.exp(rng.normal(0, 0.25))
    curve = 255 * curve + rng.normal(0, 6)
    table = curve.clip(0, 255).astype(np.uint8)[:, None, :]
    pixels = cv2.LUT(np.asarray(pixels.clip(0, 255), np.uint8), table).astype(np.float32)
    if rng.random() < 0.5:
        grey = pixels.mean(axis=2, keepdims=True)
        pixels = grey + (pixels - grey) * np.float32(0.0 if rng.random() < 0.08 else rng.uniform(0.3, 1.6))
    return pixels


def _blurred(pixels: Pixels, rng: np.random.Generator) -> Pixels:
    """A coarser sensor, a soft lens, or movement."""
    height, width = pixels.shape[:2]
    kind = rng.random()
    if kind < 0.25:
        factor = rng.uniform(1.2, 2.5)
        small = cv2.resize(pixels, (round(width / factor), round(height / factor)), interpolation=cv2.INTER_AREA)
        way = cv2.INTER_CUBIC if rng.random() < 0.5 else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(small, (width, height), interpolation=way), np.float32)
    if kind < 0.5:
        return np.asarray(cv2.GaussianBlur(pixels, (0, 0), float(rng.uniform(0.4, 1.5))), np.float32)
    if kind < 0.57:
        length = int(rng.integers(3, 8))
        kernel = np.zeros((length, length), np.float32)
        kernel[length // 2] = 1 / length
        return np.asarray(cv2.filter2D(pixels, -1, kernel), np.float32)
    return pixels


def _noisy(pixels: Pixels, rng: np.random.Generator) -> Pixels:
    """Noise of single pixels or of small blots, in brightness alone or in colours."""
    if rng.random() < 0.5:
        return pixels
    height, width = pixels.shape[:2]
    channels = 3 if rng.random() < 0.6 else 1
    coarse = int(rng.choice([1, 1, 2, 3]))
    noise = rng.standard_normal((-(-height // coarse), -(-width // coarse), channels), dtype=np.float32)
    noise = cv2.resize(noise, (width, height), interpolation=cv2.INTER_LINEAR).reshape(height, width, channels)
    return np.asarray(pixels + np.float32(rng.uniform(1.5, 12)) * noise, np.float32)
