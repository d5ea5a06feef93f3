from __future__ import annotations

import numpy as np
import pytest

from wibam_core.lifting.orientation import UNKNOWN_YAW_SD_RAD, standing_headings
from wibam_core.lifting.sizes import size_information, track_sizes
from wibam_core.lifting.trajectory import Tracks


def parked_and_passing(passing_yaw: float, lateral_m: float) -> tuple:
    """Track 0 stands at the origin along +x or −x (fits disagree by half a turn); track 1 passes beside it."""
    tracks = np.repeat([0, 1], 10)
    parameters = np.zeros((20, 6))
    parameters[:10, 5] = np.where(np.arange(10) % 2, 0.05, np.pi - 0.05)
    parameters[10:, 0], parameters[10:, 1] = np.linspace(-4, 4, 10), lateral_m
    covariance = np.tile(np.eye(6) * 1e-3, (20, 1, 1))
    yaw = np.where(tracks == 1, passing_yaw, 0.0)
    sd = np.where(tracks == 1, 0.05, np.inf)
    return Tracks.group(tracks, np.arange(20)), parameters, covariance, yaw, sd


def test_traffic_through_the_same_place_tells_front_from_rear() -> None:
    for passing, wanted in ((0.1, 1.0), (np.pi - 0.1, -1.0)):
        found = standing_headings(*parked_and_passing(passing, 0.3))
        assert np.allclose(np.cos(found.yaw_rad[:10]), wanted, atol=0.05)
        assert (found.front_sd_rad[:10] < 1).all()
        assert (found.axis_sd_rad[:10] < 0.2).all()


def test_traffic_elsewhere_tells_nothing() -> None:
    found = standing_headings(*parked_and_passing(0.1, 6.0))
    assert (found.front_sd_rad[:10] == UNKNOWN_YAW_SD_RAD).all()


def parked_beside_a_road(lateral_m: float, lanes: dict[float, float]) -> tuple:
    """Track 0 stands ``lateral_m`` to the left of the x axis, along it; the others drive in lanes (y: yaw)."""
    along = np.arange(-30.0, 31.0, 1.0)
    n = len(along)
    tracks = np.repeat(np.arange(1 + len(lanes)), n)
    parameters = np.zeros((len(tracks), 6))
    parameters[:n, 1], parameters[:n, 5] = lateral_m, np.pi * (np.arange(n) % 2)
    yaw = np.zeros(len(tracks))
    for k, (y_m, way) in enumerate(lanes.items(), 1):
        parameters[tracks == k, 0], parameters[tracks == k, 1] = along, y_m
        yaw[tracks == k] = way
    covariance = np.tile(np.eye(6) * 1e-3, (len(tracks), 1, 1))
    return Tracks.group(tracks, np.arange(len(tracks))), parameters, covariance, yaw, np.where(tracks, 0.05, np.inf)


@pytest.mark.parametrize(
    ("lateral_m", "lanes", "wanted"),
    [
        (-4.7, {-1.8: 0.0, 1.8: np.pi}, 1.0),  # on the right of a road on which one keeps right
        (4.7, {-1.8: 0.0, 1.8: np.pi}, -1.0),
        (-4.7, {-1.8: np.pi, 1.8: 0.0}, -1.0),  # one keeps left
        (0.0, {3.2: np.pi, -6.0: 0.0}, 0.0),  # in a lane of its own, beside the one that comes towards it
        (-4.7, {-1.8: 0.0}, 0.0),  # on which side one keeps is not seen
        (-7.0, {-1.8: 0.0, 1.8: np.pi}, 0.0),  # off the road
    ],
)
def test_who_is_parked_beside_a_lane_most_likely_faces_as_it_drives(
    lateral_m: float, lanes: dict[float, float], wanted: float
) -> None:
    found = standing_headings(*parked_beside_a_road(lateral_m, lanes))
    if wanted:
        assert np.allclose(np.cos(found.yaw_rad[:61]), wanted, atol=0.01)
        assert (found.front_sd_rad[:61] < UNKNOWN_YAW_SD_RAD).all()
    assert (found.front_sd_rad[:61] > 1.0).all(), "no network learns a front by it"
    assert ((found.front_sd_rad[:61] == UNKNOWN_YAW_SD_RAD) == (wanted == 0)).all()


def test_size_information_leaves_out_what_position_could_explain() -> None:
    jacobian = np.array([[1.0, 0, 1.0, 0, 0, 0], [1.0, 0, -1.0, 0, 0, 0], [0, 1.0, 0, 1.0, 0, 0]])
    info = size_information((jacobian.T @ jacobian)[None])[0]
    assert info[0, 0] > 1.9, "both ends of the vehicle are seen"
    assert info[1, 1] < 1e-3, "one side alone says as much of the place as of the width"


def test_a_track_s_size_is_better_than_its_sightings_and_ignores_wild_ones() -> None:
    rng = np.random.default_rng(0)
    n, true = 40, np.log([4.8, 1.9, 1.6])
    tracks = Tracks.group(np.zeros(n, np.int64), np.arange(n))
    mean, sd = np.tile(np.log([4.4, 1.8, 1.5]), (n, 1)), np.full((n, 3), 0.1)
    noise = 0.05
    info = np.tile(np.eye(3) / noise**2, (n, 1, 1))
    seen = true + rng.normal(0, noise, (n, 3))
    fits = (info[0, 0, 0] * seen + 100 * mean) / (info[0, 0, 0] + 100)
    driving = 5.0 * np.arange(n)[:, None] * [1.0, 0.0]
    size, covariance = track_sizes(tracks, fits, info, mean, sd, driving)
    assert np.abs(size[0] - true).max() < 0.03
    assert np.abs(size[0] - true).mean() < np.abs(fits - true).mean()
    fits[:5] += 0.6
    spoiled, _ = track_sizes(tracks, fits, info, mean, sd, driving)
    assert np.abs(spoiled[0] - true).max() < 0.04
    assert (np.sqrt(np.diagonal(covariance[0])) < 0.03).all()


def test_a_long_wait_does_not_outweigh_what_a_drive_shows() -> None:
    """Waiting, a vehicle shows nothing of its length; driving, all of it."""
    waits, drives = 200, 8
    n = waits + drives
    tracks = Tracks.group(np.zeros(n, np.int64), np.arange(n))
    mean, sd = np.tile(np.log([8.0, 2.5, 3.2]), (n, 1)), np.tile([0.2, 0.06, 0.12], (n, 1))
    along = np.concatenate([np.zeros(waits), 5.0 * np.arange(1, drives + 1)])
    info = np.zeros((n, 3, 3))
    info[:waits, 1, 1] = info[waits:, 0, 0] = 0.05**-2
    fits = mean.copy()
    fits[waits:, 0] += np.log(6.2 / 8.0) * 0.05**-2 / (0.05**-2 + 0.2**-2)
    size, covariance = track_sizes(tracks, fits, info, mean, sd, along[:, None] * [1.0, 0.0])
    assert np.exp(size[0, 0]) == pytest.approx(6.2, abs=0.1)
    assert covariance[0, 0, 0] ** 0.5 < 0.05


def test_without_information_the_prior_remains() -> None:
    tracks = Tracks.group(np.zeros(3, np.int64), np.arange(3))
    mean, sd = np.tile(np.log([4.4, 1.8, 1.5]), (3, 1)), np.full((3, 3), 0.1)
    size, covariance = track_sizes(tracks, mean, np.zeros((3, 3, 3)), mean, sd, np.zeros((3, 2)))
    assert np.allclose(size[0], mean[0])
    assert np.allclose(np.sqrt(np.diagonal(covariance[0])), 0.1)
