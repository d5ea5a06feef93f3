"""How the tracks' own standard deviations spread into the measures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import LENGTH, SIZE, YAW, X, Y
from wibam_core.safety.pet import Encroachment
from wibam_core.safety.ttc import time_to_collision
from wibam_core.scene import Track

Array = NDArray[np.float64]

DRAWS = 200
#: A track's speed rests on its positions over about this long: the speed's standard deviation is √2 · that of the
#: position along the heading, divided by it.
_SPEED_WINDOW_S = 1.0
#: 5 % and 95 % of the normal distribution lie this many standard deviations from the mean.
_NORMAL_90 = 1.6449


@dataclass(frozen=True)
class Interval:
    """90 % interval, in s; inf where no collision is foreseen."""

    low_s: float
    high_s: float

    @classmethod
    def of(cls, draws: Array) -> Interval:
        """From draws (K,) that may be inf."""
        low, high = np.quantile(draws, [0.05, 0.95], method="nearest")
        return cls(float(low), float(high))


def ttc_draws(a: Track, i: int, b: Track, j: int, rng: np.random.Generator) -> Array:
    """(`DRAWS`,) times to collision of state ``i`` of a and ``j`` of b, drawn from their standard deviations.

    Position, size, yaw and speed are drawn independently; a moving vehicle's velocity turns with its yaw. Unknown
    standard deviations count as none.
    """
    boxes_a, velocities_a = _draw(a, i, rng)
    boxes_b, velocities_b = _draw(b, j, rng)
    return time_to_collision(boxes_a, velocities_a, boxes_b, velocities_b)


def _draw(track: Track, index: int, rng: np.random.Generator) -> tuple[Array, Array]:
    sd = np.nan_to_num(track.sd[index])
    noise = rng.normal(size=(DRAWS, 7)) * sd
    boxes = track.boxes[index] + noise
    boxes[:, SIZE] = np.maximum(boxes[:, SIZE], 0.1)
    velocity = track.velocities_mps[index]
    speed = float(np.hypot(*velocity))
    speed_sd = np.sqrt(2.0) * _sd_along(sd, float(track.boxes[index, YAW])) / _SPEED_WINDOW_S
    speeds = np.maximum(speed + rng.normal(size=DRAWS) * speed_sd, 0.0) if speed > 0 else np.zeros(DRAWS)
    course = np.arctan2(velocity[1], velocity[0]) + noise[:, 6]
    return boxes, speeds[:, None] * np.stack([np.cos(course), np.sin(course)], axis=1)


def pet_interval(a: Track, b: Track, encroachment: Encroachment) -> Interval:
    """First-order interval of a post-encroachment time: each one's position along its path over its speed."""
    times = (encroachment.leaves_ns, encroachment.arrives_ns)
    variance = 0.0
    for track, time in zip((a, b) if encroachment.first_index == 0 else (b, a), times, strict=True):
        k = int(np.argmin(np.abs(track.times_ns - time)))
        along = _sd_along(np.nan_to_num(track.sd[k]), float(track.boxes[k, YAW]))
        length = float(np.nan_to_num(track.sd[k, LENGTH])) / 2
        variance += (along**2 + length**2) / max(float(np.hypot(*track.velocities_mps[k])), 0.1) ** 2
    spread = _NORMAL_90 * float(np.sqrt(variance))
    return Interval(max(encroachment.pet_s - spread, 0.0), encroachment.pet_s + spread)


def _sd_along(sd: Array, yaw_rad: float) -> float:
    """Standard deviation of the position along the heading."""
    return float(np.hypot(sd[X] * np.cos(yaw_rad), sd[Y] * np.sin(yaw_rad)))
