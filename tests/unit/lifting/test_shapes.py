from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.unit.lifting.test_fit import RIG, problem, random_vehicles, template_boxes
from wibam_core.lifting.fit import FitProblem, fit, with_bodies, with_noise
from wibam_core.lifting.shapes import MODE_SD, MODES, Shapes, deformed, learn_shapes
from wibam_core.lifting.trajectory import Tracks
from wibam_core.road_users import BODIES, CLASSES, RoadUserClass

SIGHTINGS = 6


def site(
    vehicle_class: RoadUserClass, modes: np.ndarray, vehicles: int = 20, noise_px: float = 0.0, seed: int = 0
) -> tuple[FitProblem, np.ndarray, Tracks, np.ndarray]:
    """Exact boxes of vehicles with a deformed body, each sighted at several places: problem, classes, tracks, truth."""
    rng = np.random.default_rng(seed)
    k = vehicle_class.number
    truth = np.repeat(random_vehicles(vehicles, seed, vehicle_class), SIGHTINGS, axis=0)
    truth[:, :2] = rng.uniform(-8, 8, (len(truth), 2))
    truth[:, 5] += rng.normal(0, 0.5, len(truth))
    p = problem(truth, vehicle_class=vehicle_class)
    all_modes = np.zeros((len(CLASSES), len(MODES)))
    all_modes[k] = modes
    body = np.tile(deformed(BODIES, all_modes)[k], (len(truth), 1, 1))
    boxes = template_boxes(RIG, truth, body) + rng.normal(0, noise_px, (len(truth), len(RIG), 4))
    mean, weight = p.prior_mean.clone(), p.prior_weight.clone()
    mean[:, :2] = torch.as_tensor(truth[:, :2] + rng.normal(0, 0.5, (len(truth), 2)))
    mean[:, 5], weight[:, 5] = torch.as_tensor(truth[:, 5] + rng.normal(0, 0.03, len(truth))), 0.06**-2
    p = with_noise(p, 0.5)
    p = replace(p, boxes=torch.as_tensor(boxes, dtype=torch.float32), prior_mean=mean, prior_weight=weight)
    ids = np.repeat(np.arange(vehicles), SIGHTINGS)
    times = np.tile(np.arange(SIGHTINGS) * 1_000_000_000, vehicles)
    return p, np.full(len(truth), k), Tracks.group(ids, times), truth


def learned(p: FitProblem, classes: np.ndarray, tracks: Tracks) -> Shapes:
    return learn_shapes(p, classes, tracks, np.ones(len(p), dtype=bool), iterations=50, min_tracks=5)


def size_error(p: FitProblem, bodies: np.ndarray, classes: np.ndarray, truth: np.ndarray) -> float:
    """Mean error of log sizes that is common to all vehicles, largest of length, width and height."""
    found = fit(with_bodies(p, bodies[classes]), p.prior_mean[:, None], 50).parameters.numpy()
    return float(np.abs((found - truth)[:, 2:5].mean(axis=0)).max())


@pytest.mark.parametrize("sign", [1, -1])
def test_a_wrong_body_is_recovered(sign: int) -> None:
    modes = sign * np.array([0.06, -0.05, -0.06, 0.05, -0.06])
    p, classes, tracks, truth = site(RoadUserClass.CAR, modes, noise_px=0.5)
    found = learned(p, classes, tracks)
    car = RoadUserClass.CAR.number
    assert found.tracks[car] == 20
    assert np.abs(found.modes[car] - modes).max() < 0.03
    assert (np.abs(found.modes[car] - modes) < 2.5 * found.sd[car]).all()
    assert size_error(p, found.bodies, classes, truth) < 0.4 * size_error(p, BODIES, classes, truth)


@pytest.mark.parametrize("vehicle_class", CLASSES)
def test_a_right_body_is_left_alone(vehicle_class: RoadUserClass) -> None:
    p, classes, tracks, _ = site(vehicle_class, np.zeros(len(MODES)), vehicles=10, noise_px=0.5)
    found = learned(p, classes, tracks)
    assert np.abs(found.modes).max() < 0.015
    others = np.arange(len(CLASSES)) != vehicle_class.number
    np.testing.assert_array_equal(found.bodies[others], BODIES[others])


def test_a_body_that_explains_hardly_more_is_not_taken() -> None:
    """Modes of a body that is nearly right, under noise: they would say more of the noise than of the body."""
    modes = 0.4 * np.array([0.06, -0.05, -0.06, 0.05, -0.06])
    p, classes, tracks, _ = site(RoadUserClass.CAR, modes, noise_px=1.5)
    found = learned(p, classes, tracks)
    np.testing.assert_array_equal(found.bodies, BODIES)
    assert found.statistics() == {}


def test_vehicles_larger_than_usual_are_no_other_shape() -> None:
    """What a site's vehicles have in common is their size as well: a mode must not stand in for it."""
    p, classes, tracks, _ = site(RoadUserClass.CAR, np.zeros(len(MODES)), noise_px=0.5)
    p.prior_mean[:, 2:5] -= torch.tensor([0.07, 0.04, 0.05])
    assert np.abs(learned(p, classes, tracks).modes).max() < 0.02


def test_few_tracks_keep_the_template() -> None:
    p, classes, tracks, _ = site(RoadUserClass.VAN, np.full(len(MODES), 0.05), vehicles=4)
    found = learned(p, classes, tracks)
    np.testing.assert_array_equal(found.bodies, BODIES)
    np.testing.assert_array_equal(found.sd, np.tile(MODE_SD, (len(CLASSES), 1)))
    assert found.statistics() == {}


def test_sightings_that_cannot_be_used_are_not() -> None:
    p, classes, tracks, _ = site(RoadUserClass.CAR, np.full(len(MODES), 0.05))
    found = learn_shapes(p, classes, tracks, np.zeros(len(p), dtype=bool), iterations=50, min_tracks=5)
    np.testing.assert_array_equal(found.bodies, BODIES)


def test_statistics_name_the_modes_and_repeat_exactly() -> None:
    p, classes, tracks, _ = site(RoadUserClass.CAR, np.full(len(MODES), 0.05), vehicles=6)
    first, second = (learned(p, classes, tracks).statistics() for _ in range(2))
    assert first == second
    assert list(first) == ["car"]
    assert first["car"].tracks == 6
    assert tuple(first["car"].modes) == tuple(first["car"].sd) == MODES
    assert all(0 < sd < prior for sd, prior in zip(first["car"].sd.values(), MODE_SD, strict=True))


def test_no_point_leaves_the_vehicle() -> None:
    for sign in (1, -1):
        bodies = deformed(BODIES, np.full((len(CLASSES), len(MODES)), sign * 0.2))
        assert np.abs(bodies).max() <= 0.5
    np.testing.assert_array_equal(deformed(BODIES, np.zeros((len(CLASSES), len(MODES)))), BODIES)
