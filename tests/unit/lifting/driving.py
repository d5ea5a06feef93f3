"""Measured tracks of vehicles whose path is known."""

from __future__ import annotations

import numpy as np

from wibam_core.lifting.trajectory import Tracks


def drive(
    path: np.ndarray, times_s: np.ndarray, noise_m: float = 0.3, seed: int = 0
) -> tuple[Tracks, np.ndarray, np.ndarray]:
    """One track along ``path`` (N, 2), its measured places (N, 2) and their covariances (N, 2, 2)."""
    rng = np.random.default_rng(seed)
    tracks = Tracks.group(np.zeros(len(path), np.int64), np.rint(times_s * 1e9).astype(np.int64))
    return tracks, path + rng.normal(0, noise_m, path.shape), np.tile(noise_m**2 * np.eye(2), (len(path), 1, 1))
