from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.builders import corner_rig
from wibam_core.geometry.box3d import vehicle_to_world
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.lifting.fit import YAW, FitProblem, _linearise, evaluate, fit, with_noise, yaw_starts
from wibam_core.lifting.noise import noise_of
from wibam_core.road_users import BODIES, CLASSES, LOG_SIZE_MEAN, LOG_SIZE_SD, RoadUserClass
from wibam_core.scene import CameraRig

RIG = corner_rig()


def random_vehicles(count: int, seed: int = 0, vehicle_class: RoadUserClass = RoadUserClass.CAR) -> np.ndarray:
    """(B, 6) parameters of usual sizes within 8 m of the middle."""
    rng = np.random.default_rng(seed)
    k = vehicle_class.number
    sizes = LOG_SIZE_MEAN[k] + rng.normal(0, 0.7, (count, 3)) * LOG_SIZE_SD[k]
    return np.concatenate([rng.uniform(-8, 8, (count, 2)), sizes, rng.uniform(-np.pi, np.pi, (count, 1))], axis=1)


def template_boxes(rig: CameraRig, parameters: np.ndarray, body: np.ndarray) -> np.ndarray:
    """(B, V, 4) exact tight boxes of the body, by the NumPy cameras."""
    size = np.exp(parameters[:, 2:5])
    boxes = np.concatenate([parameters[:, :2], size[:, 2:] / 2, size, parameters[:, YAW:]], axis=1)
    world = vehicle_to_world(boxes, body * size[:, None])
    uv = np.stack([camera.project(world)[0] for camera in rig.values()], axis=1)
    return np.concatenate([uv.min(axis=2), uv.max(axis=2)], axis=-1)


def problem(
    parameters: np.ndarray,
    rig: CameraRig = RIG,
    vehicle_class: RoadUserClass = RoadUserClass.CAR,
    dtype: torch.dtype = torch.float32,
    prior: float = 1.0,
) -> FitProblem:
    """Exact boxes of the template itself, a class prior and no other knowledge."""
    b, v, k = len(parameters), len(rig), vehicle_class.number
    body = np.tile(BODIES[k], (b, 1, 1))
    cameras = CameraTensors.from_cameras(list(rig.values()), dtype)
    mean = np.concatenate([np.zeros((b, 2)), np.tile(LOG_SIZE_MEAN[k], (b, 1)), np.zeros((b, 1))], axis=1)
    weight = np.concatenate(
        [np.zeros((b, 2)), prior * np.tile(LOG_SIZE_SD[k] ** -2.0, (b, 1)), np.zeros((b, 1))], axis=1
    )
    boxes = template_boxes(rig, parameters, body)
    sides = np.tile(boxes[..., 2:] - boxes[..., :2], 2)
    return FitProblem(
        cameras[torch.arange(v).expand(b, v)],
        torch.as_tensor(boxes, dtype=dtype),
        torch.as_tensor(np.hypot(1.0, 0.03 * sides), dtype=dtype),
        torch.ones(b, v, dtype=torch.bool),
        torch.ones(b, v, 4, dtype=torch.bool),
        torch.zeros(b, v, 2, dtype=torch.bool),
        torch.zeros(b, v, 2, dtype=dtype),
        torch.as_tensor(body, dtype=dtype),
        torch.ones(b, dtype=dtype),
        torch.as_tensor(mean, dtype=dtype),
        torch.as_tensor(weight, dtype=dtype),
    )


def starts(p: FitProblem, truth: np.ndarray, turns: int = 4, seed: int = 1) -> torch.Tensor:
    """Within a metre of the truth, of the prior's size, at any yaw."""
    rng = np.random.default_rng(seed)
    base = p.prior_mean.clone()
    base[:, :2] = torch.as_tensor(truth[:, :2] + rng.uniform(-1, 1, (len(truth), 2)), dtype=base.dtype)
    return yaw_starts(base, turns)


def axis_error(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs((a - b + np.pi / 2) % np.pi - np.pi / 2)


@pytest.mark.parametrize("vehicle_class", CLASSES)
@pytest.mark.parametrize("dist", [(), (-0.12, 0.02, 0.001, -0.001, 0.0)])
def test_exact_boxes_give_the_vehicle_back(vehicle_class: RoadUserClass, dist: tuple[float, ...]) -> None:
    rig = corner_rig(dist=dist)
    truth = random_vehicles(30, vehicle_class=vehicle_class)
    p = problem(truth, rig, vehicle_class, prior=1e-3)
    found = fit(p, torch.cat([starts(p, truth), starts(p, truth) + torch.tensor([0, 0, 0, 0, 0, np.pi])], 1), 50)
    solved = found.parameters.numpy()
    assert np.median(np.abs(solved[:, :5] - truth[:, :5])) < 2e-3
    close = (np.hypot(*(solved - truth)[:, :2].T) < 0.1) & (axis_error(solved[:, YAW], truth[:, YAW]) < 0.05)
    assert close.mean() >= 0.9
    assert (1 - found.view_giou.numpy()[close]).mean() < 0.01


def test_gradient_and_hessian_are_those_of_the_cost() -> None:
    truth = random_vehicles(8)
    p = problem(truth, dtype=torch.float64)
    at = torch.as_tensor(truth + np.random.default_rng(3).normal(0, 0.03, truth.shape))
    state = _linearise(p, at)
    for k in range(6):
        step = torch.zeros(6, dtype=torch.float64)
        step[k] = 1e-6
        slope = (_linearise(p, at + step).cost - _linearise(p, at - step).cost) / 2e-6
        assert torch.allclose(slope, state.gradient[:, k], rtol=1e-3, atol=1e-2)
    assert (torch.linalg.eigvalsh(state.hessian) > 0).all()


def test_an_edge_that_is_cut_only_asks_for_at_least_so_far() -> None:
    truth = random_vehicles(1)
    p = problem(truth, dtype=torch.float64)
    for side, outward in enumerate((-1, -1, 1, 1)):
        exact = p.exact.clone()
        exact[0, 0, side] = False
        for beyond, free in ((30.0, True), (-30.0, False)):
            boxes = p.boxes.clone()
            boxes[0, 0, side] -= outward * beyond  # the fit reaches beyond the box, or falls short of it
            part = replace(p, boxes=boxes, exact=exact, prior_weight=p.prior_weight * 0)
            cost = float(evaluate(part, torch.as_tensor(truth)).cost)
            assert (cost < 1e-6) is free


def test_one_wrong_view_of_four_does_little_harm() -> None:
    truth = random_vehicles(30, seed=4)
    p = problem(truth)
    p.boxes[:, 2] += torch.tensor([40.0, 10.0, 40.0, 10.0])
    solved = fit(p, starts(p, truth), 50).parameters.numpy()
    assert np.median(np.hypot(*(solved - truth)[:, :2].T)) < 0.2
    assert np.median(axis_error(solved[:, YAW], truth[:, YAW])) < np.radians(4)


def test_a_late_exposure_is_allowed_for() -> None:
    truth = random_vehicles(20, seed=5)
    shift = np.tile([0.5, -0.3], (20, 1))
    moved = truth.copy()
    moved[:, :2] += shift
    p = problem(truth, prior=1e-3)
    p.boxes[:, 1] = problem(moved, prior=1e-3).boxes[:, 1]
    p.shift[:, 1] = torch.as_tensor(shift, dtype=torch.float32)
    at_truth = evaluate(p, torch.as_tensor(truth, dtype=torch.float32))
    assert float((1 - at_truth.view_giou).max()) < 1e-3


def test_a_vehicle_behind_a_camera_that_saw_it_costs() -> None:
    truth = random_vehicles(1)
    p = problem(truth)
    behind = torch.as_tensor(truth, dtype=torch.float32)
    behind[0, :2] = torch.as_tensor(2 * next(iter(RIG.values())).centre_m[:2], dtype=torch.float32)
    found = evaluate(p, behind)
    assert float(found.view_giou[0, 0]) == -1.0
    assert float(found.cost) > 36.0


def test_the_covariance_covers_the_error() -> None:
    truth = random_vehicles(200, seed=6)
    p = problem(truth)
    sides = (p.boxes[..., 2:] - p.boxes[..., :2]).repeat(1, 1, 2)
    noise = torch.randn(p.boxes.shape, generator=torch.Generator().manual_seed(0))
    p.boxes.add_(noise * torch.hypot(torch.ones_like(sides), 0.03 * sides))
    at_truth = torch.as_tensor(truth[:, None], dtype=torch.float32)
    found = fit(p, at_truth, 50)
    covariance = torch.linalg.inv(found.information + torch.diag_embed(p.prior_weight)).numpy()
    error = found.parameters.numpy() - truth
    z = error / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    spread = np.sqrt(np.mean(z**2, axis=0))
    assert (spread > 0.5).all()
    assert (spread < 1.6).all()


def test_batches_of_any_size_agree() -> None:
    truth = random_vehicles(12, seed=7)
    p = problem(truth)
    s = starts(p, truth)
    whole = fit(p, s, 30).parameters
    parts = torch.cat([fit(p[slice(k, k + 5)], s[k : k + 5], 30).parameters for k in range(0, 12, 5)])
    assert torch.allclose(whole[:, :5], parts[:, :5], atol=2e-2)


@pytest.mark.parametrize("level", [0.7, 1.0, 2.5])
def test_the_detector_s_noise_is_found(level: float) -> None:
    truth = random_vehicles(150, seed=8)
    p = problem(truth)
    sides = (p.boxes[..., 2:] - p.boxes[..., :2]).repeat(1, 1, 2)
    noise = torch.randn(p.boxes.shape, generator=torch.Generator().manual_seed(0))
    p.boxes.add_(level * noise * torch.hypot(torch.ones_like(sides), 0.03 * sides))
    p.boxes[::7, 1] += 60.0  # some wrong boxes
    start = torch.as_tensor(truth[:, None], dtype=torch.float32)
    first = noise_of(p, fit(p, start, 30))
    again = with_noise(p, first)
    second = first * noise_of(again, fit(again, start, 30))
    assert second == pytest.approx(level, rel=0.25)


def test_too_few_edges_tell_no_noise() -> None:
    truth = random_vehicles(2)
    p = problem(truth)
    assert noise_of(p, evaluate(p, torch.as_tensor(truth, dtype=torch.float32))) == 1.0


def test_an_edge_that_is_only_guessed_does_not_count_against_a_fit_that_is_near() -> None:
    truth = random_vehicles(20)
    p = problem(truth, prior=1e-3)
    width = p.boxes[..., 2] - p.boxes[..., 0]
    off = torch.zeros_like(p.boxes)
    off[..., 2] = 0.3 * width

    def overlap(share: float) -> torch.Tensor:
        sd = p.edge_sd.clone()
        sd[..., 2] = share * width
        at_truth = torch.as_tensor(truth, dtype=p.boxes.dtype)
        return evaluate(replace(p, boxes=p.boxes + off, edge_sd=sd), at_truth).view_giou

    assert overlap(0.2).min() > 0.99
    assert overlap(0.03).max() < 0.85
    assert overlap(0.1).max() < overlap(0.2).min(), "0.2 of the side is near, and 0.1 is left"
