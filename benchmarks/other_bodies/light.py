"""Sun, sky and what is reflected: colours are linear BGR, 1 is white paper in the sun."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_GAMMA = 2.2
#: Of the horizon as seen in paint and glass: how high houses and trees stand above it, rad.
_SKYLINE_RAD = 0.22


@dataclass(frozen=True, eq=False)
class Light:
    """Of one recording.

    Attributes:
        sun: (3,) unit vector towards the sun, world. direct: its light on a surface that faces it.
        zenith, horizon, ground: (3,) radiance of the sky, and of what lies below the horizon.
        skyline: (N,) height of what stands around, by direction, as a share of the most.
    """

    sun: Array
    direct: float
    zenith: Array
    horizon: Array
    ground: Array
    skyline: Array

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Light:
        """Any weather of a dry day."""
        elevation, azimuth = np.deg2rad(rng.uniform(28, 62)), rng.uniform(-np.pi, np.pi)
        sun = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        clouds = rng.uniform(0.0, 1.0)
        zenith = (1 - clouds) * np.array([0.85, 0.50, 0.26]) + clouds * np.array([0.74, 0.70, 0.68])
        horizon = (1 - clouds) * np.array([0.95, 0.85, 0.78]) + clouds * np.array([0.80, 0.78, 0.77])
        rough = rng.normal(size=24)
        skyline = np.interp(np.arange(360) / 15.0, np.arange(25), np.append(rough, rough[0]))
        return cls(sun, 0.75 * (1 - 0.9 * clouds), zenith, horizon, np.array([0.20, 0.21, 0.22]), skyline)

    def irradiance(self, normals: Array) -> Array:
        """(N, 3) light that falls on surfaces with normals (N, 3) in the open."""
        up = 0.5 + 0.5 * normals[:, 2:]
        sky = 0.55 * (0.6 * self.zenith + 0.4 * self.horizon)
        sunlight = self.direct * np.clip(normals @ self.sun, 0, None)[:, None] * np.array([0.90, 0.97, 1.0])
        return np.asarray(up * sky + (1 - up) * self.ground * 0.7 + sunlight)

    def sky(self, directions: Array) -> Array:
        """(N, 3) radiance of the sky in directions (N, 3), as if nothing stood around."""
        share = np.clip(np.arcsin(np.clip(directions[:, 2], 0, 1)) / (np.pi / 2), 0, 1)[:, None] ** 0.6
        return np.asarray((1 - share) * self.horizon + share * self.zenith)

    def radiance(self, directions: Array) -> Array:
        """(N, 3) what is mirrored of directions (N, 3): sky, what stands around, ground, and the sun's glare."""
        elevation = np.arcsin(np.clip(directions[:, 2], -1, 1))
        azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0])).astype(np.int64) % 360
        top = _SKYLINE_RAD * (1 + 0.6 * self.skyline[azimuth])
        things = np.array([0.10, 0.13, 0.12]) * (1 + 0.35 * self.skyline[(azimuth * 7) % 360])[:, None]
        seen = np.where((elevation < top)[:, None], things, self.sky(directions))
        seen = np.where((elevation < 0)[:, None], self.ground * 0.8, seen)
        glare = 8.0 * self.direct * np.clip(directions @ self.sun, 0, 1) ** 180
        return np.asarray(seen + glare[:, None])


def reflected(views: Array, normals: Array) -> Array:
    """(N, 3) directions in which rays (N, 3) go on that meet surfaces with normals (N, 3)."""
    return np.asarray(views - 2 * np.einsum("ij,ij->i", views, normals)[:, None] * normals)


@dataclass(frozen=True)
class Sensor:
    """What a camera makes of light: exposure, warmth, noise in grey levels, and how much its picture is sharpened."""

    exposure: float
    warmth: float
    noise: float
    sharpening: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Sensor:
        return cls(rng.uniform(0.85, 1.2), rng.normal(0, 0.04), rng.uniform(1.0, 3.5), rng.uniform(0.1, 0.7))

    def developed(self, linear: NDArray[np.float32], rng: np.random.Generator) -> Image:
        """The picture (H, W, 3) uint8 of light (H, W, 3)."""
        tint = np.array([1 - self.warmth, 1.0, 1 + self.warmth], np.float32)
        exposed = linear * (self.exposure * tint)
        # highlights roll off instead of being cut
        tone = exposed / (1 + 0.35 * exposed) * 1.35
        image = 255 * np.clip(tone, 0, 1) ** np.float32(1 / _GAMMA)
        soft = cv2.GaussianBlur(image, (0, 0), 1.0)
        image = image + np.float32(self.sharpening) * (image - soft)
        # shot noise grows with the light, and colours share most of it
        grain = rng.standard_normal(image.shape[:2], np.float32)[..., None]
        grain = 0.8 * grain + 0.6 * rng.standard_normal(image.shape, np.float32)
        noisy = image + self.noise * grain * (0.4 + 0.6 * np.sqrt(np.clip(image, 0, 255) / 255))
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
