"""How the states of tracks err: how much, and for how long.

A track's place errs smoothly: what is 0.2 m off now is off by nearly as much at the next instant, and has forgotten it
a second or two later. So its speed errs by far less than independent errors would say, and two instants are no two
witnesses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import LENGTH, SIZE, WIDTH, XY, YAW, X, Y
from wibam_core.scene import Track

Array = NDArray[np.float64]

#: So many waves make up one random error.
_WAVES = 6
#: No vehicle is shorter or narrower, m.
_LEAST_M = 0.3


@dataclass(frozen=True)
class TrackErrors:
    """Of one site's tracks.

    Attributes:
        along, across, yaw, size: what the stated standard deviations are to be multiplied with.
        along_s, across_s, yaw_s: how long errors last: they are correlated by exp(−½ (t / so long)²). Along the heading
            they change sooner: who brakes is ahead of its track or behind it for less than a second, and its speed errs
            accordingly (by 0.35 m/s where places err by 0.14 m; benchmarks/conflicts.py).
    """

    along: float = 1.0
    across: float = 1.0
    yaw: float = 1.0
    size: float = 1.0
    along_s: float = 0.4
    across_s: float = 1.0
    yaw_s: float = 1.0


@dataclass(frozen=True, eq=False)
class Drawn:
    """D versions of what a road user did at K instants that agree with its track.

    Attributes:
        boxes: (D, K, 7). velocities: (D, K, 2). yaw_rates: (D, K).
    """

    boxes: Array
    velocities: Array
    yaw_rates: Array

    def where(self, rows: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
        """Boxes (N, 7), velocities (N, 2) and yaw rates (N,) of the selected (D, K)."""
        return self.boxes[rows], self.velocities[rows], self.yaw_rates[rows]


def draw(track: Track, rows: NDArray[np.int64], errors: TrackErrors, count: int, rng: np.random.Generator) -> Drawn:
    """``count`` versions of a track at these of its instants.

    Place and yaw err as smooth random functions of time, the velocity by their slope; the size by the same all the
    time. Unknown standard deviations count as none.
    """
    time_s = (track.times_ns[rows] - track.times_ns[rows[0]]) * 1e-9
    box, sd = track.boxes[rows], track.sd[rows]
    sd = np.where(np.isfinite(sd), sd, 0.0)
    c, s = np.cos(box[:, YAW]), np.sin(box[:, YAW])
    sd_along, sd_across = np.hypot(c * sd[:, X], s * sd[:, Y]), np.hypot(s * sd[:, X], c * sd[:, Y])
    lasting_s = (errors.along_s, errors.across_s, errors.yaw_s)
    (along, across, yaw), (along_rate, across_rate, yaw_rate) = _smooth_noise(time_s, lasting_s, count, rng)
    sizes = rng.normal(size=(count, 1, 3))
    along, along_rate = along * errors.along * sd_along, along_rate * errors.along * sd_along
    across, across_rate = across * errors.across * sd_across, across_rate * errors.across * sd_across

    boxes = np.repeat(box[None], count, axis=0)
    boxes[..., X] += along * c - across * s
    boxes[..., Y] += along * s + across * c
    boxes[..., SIZE] = np.maximum(boxes[..., SIZE] + sizes * errors.size * sd[:, SIZE], _LEAST_M)
    boxes[..., YAW] += yaw * errors.yaw * sd[:, YAW]
    velocities = np.repeat(track.velocities_mps[rows][None], count, axis=0)
    velocities[..., 0] += along_rate * c - across_rate * s
    velocities[..., 1] += along_rate * s + across_rate * c
    return Drawn(boxes, velocities, track.yaw_rates_radps[rows] + yaw_rate * errors.yaw * sd[:, YAW])


def _smooth_noise(
    time_s: Array, lasting_s: Sequence[float], count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Random functions (E, count, K) of unit variance with the correlation exp(−½ (t / so long)²), and their slopes,
    for each of E times that errors last.

    Sums of waves with random frequencies and amplitudes: Rahimi & Recht, "Random features for large-scale kernel
    machines", 2007. In float32, which is far more exact than what is known of errors.
    """
    frequencies, amplitudes = [], []
    for lasts_s in lasting_s:
        frequencies.append(rng.normal(size=(count, _WAVES)) / lasts_s)
        amplitudes.append(rng.normal(size=(2, count, _WAVES)) / np.sqrt(_WAVES))
    frequency, (a, b) = np.stack(frequencies).astype(np.float32), np.stack(amplitudes, axis=1).astype(np.float32)
    phase = frequency[..., None] * time_s.astype(np.float32)
    c, s = np.cos(phase), np.sin(phase)
    value = np.einsum("edw,edwk->edk", a, c) + np.einsum("edw,edwk->edk", b, s)
    slope = np.einsum("edw,edwk->edk", frequency * b, c) - np.einsum("edw,edwk->edk", frequency * a, s)
    return value.astype(np.float64), slope.astype(np.float64)


def place_sd_m(track: Track) -> Array:
    """(T,) standard deviation of the place, the worse of the two axes, m."""
    return np.asarray(np.nan_to_num(track.sd[:, XY], nan=0.0).max(axis=1))


def shrunk(boxes: Array, by_m: float) -> Array:
    """Boxes (..., 7) with a footprint that is narrower all round, m."""
    smaller = boxes.copy()
    for column in (LENGTH, WIDTH):
        smaller[..., column] = np.maximum(smaller[..., column] - 2 * by_m, 0.5 * smaller[..., column])
    return smaller
