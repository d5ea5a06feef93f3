"""Lens distortion after OpenCV, its inverse, and how far out there is one.

Normalised image coordinates (x/z, y/z) of the ideal pinhole become those of the lens:

    x' = x·R + 2·p1·x·y + p2·(r² + 2·x²) + s1·r² + s2·r⁴
    y' = y·R + p1·(r² + 2·y²) + 2·p2·x·y + s3·r² + s4·r⁴
    R = (1 + k1·r² + k2·r⁴ + k3·r⁶) / (1 + k4·r² + k5·r⁴ + k6·r⁶)

(OpenCV, "Camera Calibration and 3D Reconstruction"). Far from where the lens was measured this map may fold back and
throw a far-away point into the image. Beyond a radius ``limit`` it is therefore continued in straight lines from the
axis: a point q times as far out as the limit lands q times as far out as the point at the limit does. With a limit of
at most `monotone_radius` the map is one-to-one over the whole plane, and `undistort` is its inverse everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Points farther out than this multiple of the image's farthest point are not distorted any further: the coefficients
#: were measured within the image, and a polynomial is anyone's guess beyond what it was fitted to.
TRUSTED_SHARE = 1.3
#: Coefficients of the formula, in OpenCV's order: k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4.
COEFFICIENTS = 12
#: The map counts as monotone where no direction is compressed to less than this share, nor any stretched by more than
#: its inverse (a rational formula has poles).
_SMALLEST_SLOPE = 0.05
#: Lenses are looked at up to this angle from the axis.
_WIDEST_RAD = np.deg2rad(89.0)
#: Newton's method ends when all points are met to this many rounding errors, usually after 4 to 8 steps.
ROUNDINGS = 64.0
MAX_STEPS = 60
#: Points are undistorted this many at a time, to stay in the processor's cache.
_PART = 65536


def polynomial(coefficients: Sequence[Any], x: Any, y: Any) -> tuple[Any, Any]:
    """The formula itself, without continuation: distorted x and y, for NumPy arrays and tensors alike."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = coefficients
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2)
    dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4)
    return x * radial + dx, y * radial + dy


def polynomial_slopes(coefficients: Sequence[Any], x: Any, y: Any) -> tuple[Any, Any, Any, Any]:
    """Derivatives dx'/dx, dx'/dy, dy'/dx, dy'/dy of `polynomial`, for NumPy arrays and tensors alike."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = coefficients
    r2 = x * x + y * y
    above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = above / below
    # twice the derivative of the radial factor by r²: multiplied by x or y, that by x or y
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3) - radial * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / below
    prism_x, prism_y = 2 * (s1 + 2 * r2 * s2), 2 * (s3 + 2 * r2 * s4)
    cross = x * y * slope + 2 * (p1 * x + p2 * y)
    return (
        radial + x * x * slope + 2 * p1 * y + 6 * p2 * x + prism_x * x,
        cross + prism_x * y,
        cross + prism_y * x,
        radial + y * y * slope + 6 * p1 * y + 2 * p2 * x + prism_y * y,
    )


def distort(coefficients: Sequence[float], xy: Array, limit: float) -> Array:
    """Ideal normalised coordinates (..., 2) to those of the lens (..., 2)."""
    inside = limit / np.maximum(np.linalg.norm(xy, axis=-1), limit)
    x, y = polynomial(coefficients, xy[..., 0] * inside, xy[..., 1] * inside)
    return np.stack([x / inside, y / inside], axis=-1)


def _newton_steps(coefficients: Sequence[float], xy: Array, limit: float, missing: Array) -> Array:
    """Moves (..., 2) of points (..., 2) that change what `distort` gives by ``missing`` (..., 2), to first order."""
    inside = limit / np.maximum(np.linalg.norm(xy, axis=-1), limit)
    x, y = xy[..., 0] * inside, xy[..., 1] * inside
    a, b, c, d = polynomial_slopes(coefficients, x, y)
    # beyond the limit, moving outwards goes along the straight continuation instead
    ux, uy = x / limit, y / limit
    sx, sy = polynomial(coefficients, x, y)
    beyond = inside < 1
    kink_x, kink_y = beyond * (sx / limit - a * ux - b * uy), beyond * (sy / limit - c * ux - d * uy)
    a, b, c, d = a + kink_x * ux, b + kink_x * uy, c + kink_y * ux, d + kink_y * uy
    u, v = missing[..., 0], missing[..., 1]
    return np.stack([d * u - b * v, a * v - c * u], axis=-1) / (a * d - b * c)[..., None]


def undistort(coefficients: Sequence[float], target: Array, limit: float) -> Array:
    """Normalised coordinates of the lens (..., 2) to the ideal ones (..., 2), the inverse of `distort`."""
    flat = target.reshape(-1, 2)
    parts = np.array_split(flat, len(flat) // _PART + 1)
    return np.concatenate([_undistort(coefficients, part, limit) for part in parts]).reshape(target.shape)


def _undistort(coefficients: Sequence[float], flat: Array, limit: float) -> Array:
    """(N, 2) by Newton's method; a step that leads away from the target is halved until it does not."""
    found = flat.copy()
    enough = ROUNDINGS * np.finfo(np.float64).eps * np.maximum(1.0, np.linalg.norm(flat, axis=-1))
    missing = flat - distort(coefficients, found, limit)
    error = np.linalg.norm(missing, axis=-1)
    found[np.isnan(error)] = np.nan
    step = _newton_steps(coefficients, found, limit, missing)
    left = np.arange(len(flat))  # the points that are not there yet; error and step are theirs
    for _ in range(MAX_STEPS):
        far = error > enough[left]
        left, error, step = left[far], error[far], step[far]
        if not len(left):
            break
        trial = found[left] + step
        missing = flat[left] - distort(coefficients, trial, limit)
        trial_error = np.linalg.norm(missing, axis=-1)
        closer = trial_error < error
        found[left[closer]] = trial[closer]
        error = np.where(closer, trial_error, error)
        step = np.where(closer[:, None], _newton_steps(coefficients, trial, limit, missing), step / 2)
    return found


@lru_cache(maxsize=256)
def monotone_radius(coefficients: tuple[float, ...]) -> float:
    """Ideal radius (tan of the angle to the axis) within which the formula is one-to-one, and so is its continuation.

    Inside, because the symmetric part of its derivative is positive definite on a disk (Gale & Nikaido, "The Jacobian
    matrix and global univalence of mappings", Math. Annalen 159, 1965); outside, because rays from the axis meet the
    image of that disk's edge once: no theorem, but so for every random lens of the tests.
    """
    radii = np.tan(np.linspace(0.0, _WIDEST_RAD, 357))[1:]
    angles = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
    ux, uy = np.cos(angles), np.sin(angles)

    def is_monotone(radius: Array) -> NDArray[np.bool_]:
        """(N,) whether it is, in all directions at radii (N,); not so where the formula overflows."""
        x, y = radius[:, None] * ux, radius[:, None] * uy
        a, b, c, d = polynomial_slopes(coefficients, x, y)
        symmetric = (a + d) / 2 - np.hypot((a - d) / 2, (b + c) / 2)
        stretch = np.sqrt(a * a + b * b + c * c + d * d)
        return np.asarray(((symmetric >= _SMALLEST_SLOPE) & (stretch <= 1 / _SMALLEST_SLOPE)).all(axis=1))

    with np.errstate(all="ignore"):
        bad = ~is_monotone(radii)
        if not bad.any():
            return float(radii[-1])
        first = int(bad.argmax())
        low, high = (radii[first - 1] if first else 0.0), radii[first]
        for _ in range(30):
            middle = (low + high) / 2
            if is_monotone(np.array([middle]))[0]:
                low = middle
            else:
                high = middle
    return max(float(low), 1e-9)
