"""What other formats ask of a track beyond its states: numbered frames, accelerations."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from wibam_core.scene import FloatArray, IntArray, Track

#: What the frames are taken to be apart where there is one instant alone.
_LONE_PERIOD_NS = 100_000_000


def frame_period_ns(times_ns: Iterable[IntArray]) -> int:
    """The shortest time between two of all instants: no two of them get the same number from `frame_numbers`.

    Args:
        times_ns: (T,) each, e.g. of all tracks.
    """
    instants = np.unique(np.concatenate([np.empty(0, np.int64), *times_ns]))
    return int(np.diff(instants).min()) if len(instants) > 1 else _LONE_PERIOD_NS


def frame_numbers(times_ns: IntArray, period_ns: int) -> IntArray:
    """Numbers (T,) of the frames nearest to times (T,), halves upwards; frame 0 is at time 0."""
    return (2 * np.asarray(times_ns, np.int64) + period_ns) // (2 * period_ns)


def derivative(values: FloatArray, times_ns: IntArray) -> FloatArray:
    """Change per second (T, ...) of values (T, ...), by central differences; zero for a single instant."""
    if len(times_ns) < 2:
        return np.zeros_like(values)
    return np.gradient(values, np.asarray(times_ns) * 1e-9, axis=0)


def along_and_across(vectors: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Components (T, 2) of world vectors (T, 2) forward and to the left of headings (T,)."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack([c * vectors[:, 0] + s * vectors[:, 1], c * vectors[:, 1] - s * vectors[:, 0]], axis=1)


def accelerations_mps2(track: Track) -> FloatArray:
    """(T, 2) along world X and Y."""
    return derivative(track.velocities_mps, track.times_ns)
