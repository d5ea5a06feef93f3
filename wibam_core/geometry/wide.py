"""Lenses that see half of the sphere around them, or more: fisheyes and omnidirectional ones, with their inverses.

A pinhole's image plane ends 90 degrees from its axis. These lenses map directions instead of points of that plane. A
direction at the angle θ from the axis, in the plane (x, y) around it, becomes a point of the *lens plane*, which the
intrinsic matrix K turns into pixels:

- ``fisheye`` (`cv2.fisheye`; Kannala & Brandt, PAMI 2006): it lies θ·(1 + k1·θ² + k2·θ⁴ + k3·θ⁶ + k4·θ⁸) from the
  middle, towards (x, y).
- ``omnidirectional`` (`cv2.omnidir`; Mei & Rives, ICRA 2007): the direction's point on the unit sphere is seen from a
  point ``xi`` behind the sphere's centre, (x, y) / (z + xi), and then distorted by k1, k2, p1, p2 as in
  `wibam_core.geometry.distortion`.

Both formulas may fold back far from the axis. Directions beyond the angle at which they begin to are not seen.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry import distortion

Array = NDArray[np.float64]

#: No lens is looked at farther from its axis than this.
_WIDEST_RAD = np.deg2rad(170.0)
#: A lens folds back where a step of the angle moves a point of the lens plane by less than this share of it.
_SMALLEST_SLOPE = 0.05
#: Newton's method from the nearest entry of a table of angles of so many entries ends in that many steps.
_TABLE, _STEPS = 512, 6
#: Angles are kept this far from where the unified model's projection goes to infinity.
_MARGIN_RAD = 0.02


class WideLens(Protocol):
    """Directions to points of the lens plane, and back."""

    @property
    def limit_rad(self) -> float:
        """Directions farther from the axis are not seen."""

    def to_plane(self, points_cam: Array) -> Array:
        """Camera-frame points (..., 3) to the lens plane (..., 2); NaN for what is not seen."""

    def to_directions(self, plane: Array) -> Array:
        """Points of the lens plane (..., 2) to unit directions (..., 3) of the camera's frame; NaN where there is
        none."""


def angles_rad(points_cam: Array) -> Array:
    """Angles (...) in [0, π] between the optical axis and camera-frame points (..., 3)."""
    return np.asarray(np.arctan2(np.hypot(points_cam[..., 0], points_cam[..., 1]), points_cam[..., 2]))


@dataclass(frozen=True)
class Fisheye:
    """The equidistant model of `cv2.fisheye`.

    Attributes:
        coefficients: k1, k2, k3, k4.
        limit_rad: where the formula begins to fold back, 170 degrees at most.
    """

    coefficients: tuple[float, float, float, float]
    limit_rad: float = field(init=False)

    def __post_init__(self) -> None:
        angles = np.linspace(0.0, _WIDEST_RAD, 1701)
        bad = ~(self._slope(angles) >= _SMALLEST_SLOPE)
        object.__setattr__(self, "limit_rad", float(angles[max(int(bad.argmax()) - 1, 1)] if bad.any() else angles[-1]))

    def _radius(self, angle: Array) -> Array:
        k1, k2, k3, k4 = self.coefficients
        a2 = angle * angle
        return np.asarray(angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))))

    def _slope(self, angle: Array) -> Array:
        k1, k2, k3, k4 = self.coefficients
        a2 = angle * angle
        return np.asarray(1 + a2 * (3 * k1 + a2 * (5 * k2 + a2 * (7 * k3 + a2 * 9 * k4))))

    def to_plane(self, points_cam: Array) -> Array:
        """See `WideLens`."""
        across = np.hypot(points_cam[..., 0], points_cam[..., 1])
        angle = np.arctan2(across, points_cam[..., 2])
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(across > 0, self._radius(angle) / across, 1.0)
        return np.asarray(points_cam[..., :2] * np.where(angle <= self.limit_rad, scale, np.nan)[..., None])

    def to_directions(self, plane: Array) -> Array:
        """See `WideLens`."""
        radius = np.hypot(plane[..., 0], plane[..., 1])
        table = np.linspace(0.0, self.limit_rad, _TABLE)
        radii = self._radius(table)
        angle = np.interp(radius, radii, table)
        for _ in range(_STEPS):
            step = (self._radius(angle) - radius) / self._slope(angle)
            angle = np.clip(angle - step, 0.0, self.limit_rad)
        angle = np.where(radius <= radii[-1] * (1 + 1e-12), angle, np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            towards = np.where((radius > 0)[..., None], plane / radius[..., None], 0.0)
        return np.concatenate([towards * np.sin(angle)[..., None], np.cos(angle)[..., None]], axis=-1)


@dataclass(frozen=True)
class Omnidirectional:
    """The unified model of `cv2.omnidir`.

    Attributes:
        xi: how far behind the sphere's centre it is seen from; 0 is a pinhole, 1 a parabolic mirror.
        coefficients: k1, k2, p1, p2.
        widest: (..., 2) points of the lens plane that the image shows; the distortion is not followed far beyond them.
        limit_rad: what is farther from the axis is not seen, by the sphere's geometry.
        distortion_limit: radius of the ideal lens plane beyond which the distortion goes on in straight lines.
    """

    xi: float
    coefficients: tuple[float, float, float, float]
    widest: tuple[tuple[float, float], ...]
    limit_rad: float = field(init=False)
    distortion_limit: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        horizon = np.arccos(-self.xi if self.xi <= 1 else -1 / self.xi)
        object.__setattr__(self, "limit_rad", float(min(horizon - _MARGIN_RAD, _WIDEST_RAD)))
        monotone = distortion.monotone_radius(self._formula)
        border = distortion.undistort(self._formula, np.array(self.widest, dtype=np.float64), monotone)
        reach = float(np.linalg.norm(border, axis=-1).max())
        object.__setattr__(self, "distortion_limit", min(monotone, distortion.TRUSTED_SHARE * reach))

    @property
    def _formula(self) -> tuple[float, ...]:
        return (*self.coefficients, *(0.0,) * (distortion.COEFFICIENTS - 4))

    def to_plane(self, points_cam: Array) -> Array:
        """See `WideLens`."""
        seen = angles_rad(points_cam) <= self.limit_rad
        along = points_cam[..., 2] + self.xi * np.linalg.norm(points_cam, axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            ideal = np.where(seen[..., None], points_cam[..., :2] / along[..., None], 0.0)
        return np.where(seen[..., None], distortion.distort(self._formula, ideal, self.distortion_limit), np.nan)

    def to_directions(self, plane: Array) -> Array:
        """See `WideLens`."""
        ideal = distortion.undistort(self._formula, plane, self.distortion_limit)
        r2 = (ideal * ideal).sum(axis=-1)
        with np.errstate(invalid="ignore"):
            lift = (self.xi + np.sqrt(1 + (1 - self.xi**2) * r2)) / (1 + r2)
        directions = np.concatenate([ideal * lift[..., None], (lift - self.xi)[..., None]], axis=-1)
        with np.errstate(invalid="ignore"):
            seen = angles_rad(directions) <= self.limit_rad
        return np.where(seen[..., None], directions, np.nan)
