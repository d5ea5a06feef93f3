from __future__ import annotations

import numpy as np
import pytest

from tests.unit.lifting.driving import drive
from wibam_core.lifting.headings import Headings, headings
from wibam_core.lifting.trajectory import Tracks, smooth
from wibam_core.road_users import RoadUserClass

#: As places of single fits.
JUMP_M = 0.4


def of_cars(tracks: Tracks) -> np.ndarray:
    return np.full(len(tracks.rows), RoadUserClass.CAR.number)


def by_motion(path: np.ndarray, times_s: np.ndarray, noise_m: float = 0.3, seed: int = 0) -> Headings:
    tracks, measured, covariances = drive(path, times_s, noise_m, seed)
    return headings(tracks, of_cars(tracks), smooth(tracks, measured, covariances), JUMP_M)


def off(yaw_rad: np.ndarray, true_rad: np.ndarray | float) -> np.ndarray:
    return np.abs((yaw_rad - true_rad + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize("way", [0.3, 2.9, -2.0])
def test_a_vehicle_that_stops_keeps_its_heading(way: float) -> None:
    times = np.arange(150) * 0.08
    along = np.where(times < 4, 8 * times - times**2, 16.0) + np.where(times > 8, 1.0 * (times - 8) ** 2, 0.0)
    path = along[:, None] * [np.cos(way), np.sin(way)]
    tracks, measured, covariances = drive(path, times)
    found = headings(tracks, of_cars(tracks), smooth(tracks, measured, covariances), JUMP_M)
    error = np.abs((found.yaw_rad[0] - way + np.pi) % (2 * np.pi) - np.pi)
    assert error.max() < 0.25
    assert (error / found.sd_rad[0]).max() < 3.5
    standing = (times > 4.5) & (times < 7.5)
    assert found.sd_rad[0][standing].min() > found.sd_rad[0][~standing].min()
    assert found.sd_rad.max() < 0.4


def test_a_vehicle_that_never_moves_has_no_heading() -> None:
    times = np.arange(100) * 0.08
    tracks, measured, covariances = drive(np.zeros((100, 2)), times, noise_m=0.5)
    assert np.isinf(headings(tracks, of_cars(tracks), smooth(tracks, measured, covariances), JUMP_M).sd_rad).all()


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("aside", [(0.0, 1.2), (-1.2, 0.0), (0.8, -0.8)])
def test_a_jump_of_a_standing_vehicle_does_not_turn_it(aside: tuple[float, float], first: bool) -> None:
    times = np.arange(200) * 0.1
    moves = times > 12 if first else times < 8
    along = np.where(moves, 1.5 * (times - (12 if first else 8)) ** 2 * (1 if first else -1), 0.0)
    path = along[:, None] * [1.0, 0.0]
    jumped = (times > 4) & (times < 9) if first else (times > 11) & (times < 16)
    path[jumped] += aside  # another camera begins to see it, and stops
    found = by_motion(path, times, noise_m=0.1)
    still = ~moves
    assert off(found.yaw_rad[0][still], 0.0).max() < 0.35
    assert np.isfinite(found.sd_rad).all()


def test_a_turning_vehicle_is_followed_through_the_bend_and_past_half_a_turn() -> None:
    times = np.arange(120) * 0.1
    turned = np.clip((times - 3) * 0.6, 0, 1.25 * np.pi)  # 6 m/s on a radius of 10 m
    true = 2.5 + turned
    step = 0.6 * np.stack([np.cos(true), np.sin(true)], axis=-1)
    path = np.cumsum(step, axis=0)
    found = by_motion(path, times, noise_m=0.2)
    error = off(found.yaw_rad[0], true)
    assert error.max() < 0.35
    assert np.median(error) < 0.1
    assert (error / found.sd_rad[0]).max() < 4
    assert abs(found.yaw_rad[0, -1] - found.yaw_rad[0, 0] - 1.25 * np.pi) < 0.3  # without a jump by a whole turn


def test_tracks_do_not_disturb_each_other_whatever_their_lengths() -> None:
    times = np.arange(40) * 0.1
    path = np.stack([6.0 * times, 2.0 * times], axis=-1)
    alone = by_motion(path, times)
    _, measured, covariances = drive(path, times)
    stamps = np.concatenate([times, times[:1], times[:7]]) * 1e9
    tracks = Tracks.group(np.repeat([0, 1, 2], [40, 1, 7]), stamps.astype(np.int64))
    places, spreads = (np.concatenate([values, values[:1], values[:7]]) for values in (measured, covariances))
    together = headings(tracks, of_cars(tracks), smooth(tracks, places, spreads), JUMP_M)
    assert np.allclose(together.yaw_rad[0], alone.yaw_rad[0], atol=1e-9)
    assert np.allclose(together.sd_rad[0], alone.sd_rad[0], atol=1e-9)
    assert np.isinf(together.sd_rad[1]).all()  # one place is no motion


def test_no_tracks_have_no_headings() -> None:
    tracks = Tracks.group(np.array([-1]), np.array([0]))
    found = headings(tracks, of_cars(tracks), smooth(tracks, np.zeros((1, 2)), np.ones((1, 2, 2))), JUMP_M)
    assert found.yaw_rad.shape == found.sd_rad.shape == (0, 0)
