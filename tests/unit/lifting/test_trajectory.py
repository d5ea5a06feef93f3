from __future__ import annotations

import numpy as np

from tests.unit.lifting.driving import drive
from wibam_core.lifting.trajectory import Tracks, smooth


def test_rows_are_grouped_by_track_in_order_of_time() -> None:
    tracks = Tracks.group(np.array([5, -1, 2, 5, 5]), np.array([30, 0, 10, 10, 20]))
    assert [rows[valid].tolist() for rows, valid in zip(tracks.rows, tracks.valid, strict=True)] == [[2], [3, 4, 0]]
    out = tracks.scatter(np.array([[1.0, 0, 0], [2, 3, 4]]), np.full(5, -9.0))
    assert out.tolist() == [4, -9, 1, 2, 3]


def test_no_rows() -> None:
    tracks = Tracks.group(np.array([-1]), np.array([0]))
    assert smooth(tracks, np.zeros((1, 2)), np.ones((1, 2, 2))).state.shape == (0, 0, 4)


def test_smoothing_halves_the_noise_and_finds_the_velocity() -> None:
    times = np.arange(60) * 0.08
    path = np.stack([8.0 * times, 2.0 - 3.0 * times], axis=-1)
    tracks, measured, covariances = drive(path, times)
    motion = smooth(tracks, measured, covariances)
    assert np.sqrt(np.mean((motion.position[0] - path) ** 2)) < 0.15
    assert np.abs(motion.velocity[0, 5:-5] - [8.0, -3.0]).max() < 0.8


def test_a_wild_measurement_is_ignored() -> None:
    times = np.arange(40) * 0.08
    path = np.stack([6.0 * times, 0 * times], axis=-1)
    tracks, measured, covariances = drive(path, times, noise_m=0.2)
    measured[20] += [0.0, 4.0]
    assert abs(smooth(tracks, measured, covariances).position[0, 20, 1]) < 0.3


def test_tracks_of_unequal_length_do_not_disturb_each_other() -> None:
    times = np.arange(40) * 0.08
    path = np.stack([6.0 * times, 0 * times], axis=-1)
    alone = smooth(*drive(path, times))
    _, measured, covariances = drive(path, times)
    both = Tracks.group(np.repeat([0, 1], [40, 7]), np.concatenate([times, times[:7]]).__mul__(1e9).astype(np.int64))
    together = smooth(both, np.concatenate([measured, measured[:7]]), np.concatenate([covariances, covariances[:7]]))
    assert np.allclose(together.state[0], alone.state[0], atol=1e-9)
