"""What time adds to single fits: smooth motion.

Many tracks are smoothed at once by a Rauch–Tung–Striebel smoother whose state is position and velocity under white
acceleration; tracks are padded to a common length and processed in lockstep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wibam_core.scene import FloatArray, IntArray

#: Standard deviation of the acceleration, along each axis.
_ACCELERATION_MPS2 = 1.8
#: Standard deviation of the speed along each axis before a vehicle was seen twice.
_FIRST_SPEED_SD_MPS = 12.0
#: Places that lie farther than this many standard deviations off the smooth path count less.
_ROBUST_SD = 2.5


@dataclass(frozen=True, eq=False)
class Tracks:
    """Rows of observations grouped into M tracks of at most T rows, in order of time.

    Attributes:
        rows: (M, T) index of the observation, padded with 0. valid: (M, T).
        times_s: (M, T) since the first row of all; padding repeats the last time.
    """

    rows: IntArray
    valid: np.ndarray
    times_s: FloatArray

    @classmethod
    def group(cls, tracks: IntArray, times_ns: IntArray) -> Tracks:
        """Group observations (N,) by track id; −1 belongs to no track."""
        linked = np.flatnonzero(tracks >= 0)
        order = linked[np.lexsort((times_ns[linked], tracks[linked]))]
        _, starts, counts = np.unique(tracks[order], return_index=True, return_counts=True)
        longest = int(counts.max(initial=0))
        slot = np.arange(longest)[None]
        valid = slot < counts[:, None]
        last = starts + counts - 1
        rows = order[np.minimum(starts[:, None] + slot, last[:, None])] if longest else np.empty((0, 0), np.int64)
        origin = int(times_ns.min()) if len(times_ns) else 0
        return cls(rows, valid, (times_ns[rows] - origin) * 1e-9)

    def scatter(self, values: FloatArray, out: FloatArray) -> FloatArray:
        """Write per-track values (M, T, ...) to the observations' rows of ``out`` (N, ...)."""
        out[self.rows[self.valid]] = values[self.valid]
        return out


@dataclass(frozen=True, eq=False)
class Motion:
    """Smoothed motion of M tracks: position and velocity (M, T, 4) and its covariance (M, T, 4, 4)."""

    state: FloatArray
    covariance: FloatArray

    @property
    def position(self) -> FloatArray:
        return self.state[..., :2]

    @property
    def velocity(self) -> FloatArray:
        return self.state[..., 2:]


def smooth(tracks: Tracks, positions: FloatArray, covariances: FloatArray, robust_passes: int = 2) -> Motion:
    """Smooth positions.

    Args:
        tracks: how the observations form tracks.
        positions: (N, 2) of the observations, m.
        covariances: (N, 2, 2), m².
        robust_passes: how often measurements far from the smooth path lose weight.
    """
    measured = positions[tracks.rows]
    base = covariances[tracks.rows]
    noise = base
    motion = _rts(tracks, measured, noise)
    for _ in range(robust_passes):
        off = measured - motion.position
        squared = np.einsum("mti,mtij,mtj->mt", off, np.linalg.inv(base), off)
        noise = base * (1.0 + squared / _ROBUST_SD**2)[..., None, None]
        motion = _rts(tracks, measured, noise)
    return motion


def _transition(dt: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Transition (M, 4, 4) and process noise (M, 4, 4) over ``dt`` (M,) s."""
    eye = np.eye(2)
    step = np.tile(np.eye(4), (len(dt), 1, 1))
    step[:, :2, 2:] = dt[:, None, None] * eye
    q = _ACCELERATION_MPS2**2
    noise = np.zeros_like(step)
    noise[:, :2, :2] = (q * dt**3 / 3)[:, None, None] * eye
    noise[:, :2, 2:] = noise[:, 2:, :2] = (q * dt**2 / 2)[:, None, None] * eye
    noise[:, 2:, 2:] = (q * dt)[:, None, None] * eye
    return step, noise


def _rts(tracks: Tracks, measured: FloatArray, noise: FloatArray) -> Motion:
    m, t = tracks.valid.shape
    states, covariances = np.zeros((m, t, 4)), np.tile(np.eye(4), (m, t, 1, 1))
    if m == 0:
        return Motion(states, covariances)
    state = np.concatenate([measured[:, 0], np.zeros((m, 2))], axis=1)
    covariance = np.zeros((m, 4, 4))
    covariance[:, :2, :2] = noise[:, 0]
    covariance[:, [2, 3], [2, 3]] = _FIRST_SPEED_SD_MPS**2
    states[:, 0], covariances[:, 0] = state, covariance
    predicted: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for k in range(1, t):
        step, process = _transition(tracks.times_s[:, k] - tracks.times_s[:, k - 1])
        prior = (step @ state[..., None])[..., 0]
        prior_covariance = step @ covariance @ step.transpose(0, 2, 1) + process
        predicted.append((step, prior, prior_covariance))
        gain = prior_covariance[:, :, :2] @ np.linalg.inv(prior_covariance[:, :2, :2] + noise[:, k])
        gain = gain * tracks.valid[:, k, None, None]
        state = prior + (gain @ (measured[:, k] - prior[:, :2])[..., None])[..., 0]
        covariance = prior_covariance - gain @ prior_covariance[:, :2]
        states[:, k], covariances[:, k] = state, covariance
    for k in range(t - 2, -1, -1):
        step, prior, prior_covariance = predicted[k]
        back = covariances[:, k] @ step.transpose(0, 2, 1) @ np.linalg.inv(prior_covariance + 1e-9 * np.eye(4))
        back = back * tracks.valid[:, k + 1, None, None]
        states[:, k] += (back @ (states[:, k + 1] - prior)[..., None])[..., 0]
        covariances[:, k] += back @ (covariances[:, k + 1] - prior_covariance) @ back.transpose(0, 2, 1)
    return Motion(states, covariances)
