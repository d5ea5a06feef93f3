"""Light on the scene, and what camera electronics do to the image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.synthetic.mesh import Colour

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_NOISE_MARGIN_PX = 96
_NOISE_LEVELS = (0.0, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0)


@dataclass(frozen=True)
class Lighting:
    """Sun and sky.

    Attributes:
        sun: unit vector towards the sun, world.
        ambient, diffuse: shares of a colour seen in the shade, and added in full sun.
        shadow: brightness of ground in a shadow relative to ground in the sun (1: no shadows).
        sky_top, sky_horizon: BGR.
        haze_m: distance over which far ground fades into the horizon's colour.
    """

    sun: tuple[float, float, float]
    ambient: float
    diffuse: float
    shadow: float
    sky_top: Colour
    sky_horizon: Colour
    haze_m: float

    def shade(self, normals: Array) -> Array:
        """Brightness (N,) of faces with world normals (N, 3)."""
        direct = (normals @ np.array(self.sun)).clip(0)
        return np.asarray(self.ambient * (0.8 + 0.2 * normals[:, 2]) + self.diffuse * direct)


def sample_lighting(rng: np.random.Generator) -> Lighting:
    """Sunny, hazy or overcast, at any time of the day."""
    overcast = float(np.clip(rng.normal(0.4, 0.4), 0, 1))
    elevation, azimuth = np.deg2rad(rng.uniform(22, 70)), rng.uniform(-np.pi, np.pi)
    sun = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    blue = np.array([225.0, 175.0, 125.0]) * rng.uniform(0.75, 1.05)
    grey = np.full(3, rng.uniform(150, 215))
    top = blue * (1 - overcast) + grey * overcast
    horizon = np.clip(top * 0.4 + rng.uniform(130, 150), 0, 250)
    return Lighting(
        sun=(float(sun[0]), float(sun[1]), float(sun[2])),
        ambient=0.55 + 0.30 * overcast,
        diffuse=0.55 * (1 - overcast) + 0.12,
        shadow=0.52 + 0.42 * overcast,
        sky_top=(float(top[0]), float(top[1]), float(top[2])),
        sky_horizon=(float(horizon[0]), float(horizon[1]), float(horizon[2])),
        haze_m=float(rng.uniform(150, 500)),
    )


@dataclass(frozen=True)
class Photometry:
    """What the camera does to the light: exposure, colour cast, noise, blur and compression.

    Attributes:
        gain: exposure. gamma: tone curve. tint: per channel BGR.
        noise_sd: sensor noise in grey levels. blur_px: standard deviation of the lens blur.
        jpeg_quality: None for no compression artefacts.
    """

    gain: float = 1.0
    gamma: float = 1.0
    tint: Colour = (1.0, 1.0, 1.0)
    noise_sd: float = 2.0
    blur_px: float = 0.5
    jpeg_quality: int | None = None


def sample_photometry(rng: np.random.Generator) -> Photometry:
    """A camera with its own exposure, cast, noise, softness and compression."""
    tint = np.clip(1 + rng.normal(0, 0.03, 3), 0.88, 1.12)
    return Photometry(
        gain=float(np.exp(rng.normal(0.06, 0.2))),
        gamma=float(np.exp(rng.normal(-0.08, 0.14))),
        tint=(float(tint[0]), float(tint[1]), float(tint[2])),
        noise_sd=float(rng.choice(_NOISE_LEVELS, p=[0.1, 0.2, 0.25, 0.2, 0.12, 0.08, 0.05])),
        blur_px=float(rng.choice([0.45, 0.7, 1.1], p=[0.55, 0.33, 0.12])),
        jpeg_quality=int(rng.integers(35, 90)) if rng.random() < 0.35 else None,
    )


@lru_cache(maxsize=16)
def _noise_pool(level: float, height_px: int, width_px: int) -> tuple[Image, Image]:
    rng = np.random.default_rng(97)
    shape = (height_px + _NOISE_MARGIN_PX, width_px + _NOISE_MARGIN_PX, 3)
    field = np.rint(level * rng.standard_normal(shape, dtype=np.float32))
    return field.clip(0, 255).astype(np.uint8), (-field).clip(0, 255).astype(np.uint8)


@lru_cache(maxsize=64)
def _tone_table(gain: float, gamma: float, tint: Colour) -> Image:
    levels = np.arange(256) / 255.0
    curves = [255.0 * (levels * gain * t).clip(0, 1) ** gamma for t in tint]
    return np.stack(curves, axis=-1).round().astype(np.uint8)[None]


def develop(image: Image, photometry: Photometry, rng: np.random.Generator) -> Image:
    """The image (H, W, 3) as the camera delivers it. Costs about a millisecond: noise comes from a pool."""
    if photometry.blur_px > 0:
        image = cv2.GaussianBlur(image, (3, 3) if photometry.blur_px < 0.9 else (5, 5), photometry.blur_px)
    image = cv2.LUT(image, _tone_table(photometry.gain, photometry.gamma, photometry.tint))
    if photometry.noise_sd > 0:
        level = min(_NOISE_LEVELS, key=lambda n: abs(n - photometry.noise_sd))
        height, width = image.shape[:2]
        brighter, darker = _noise_pool(level, height, width)
        x, y = rng.integers(0, _NOISE_MARGIN_PX, 2)
        image = cv2.add(image, brighter[y : y + height, x : x + width])
        image = cv2.subtract(image, darker[y : y + height, x : x + width])
    if photometry.jpeg_quality is not None:
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, photometry.jpeg_quality])
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
    return image
