"""Parts of the loss: least at the truth, blind to what is not known, and equal to their formulas."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.labelled_views import VEHICLES, camera, view_of
from wibam_core.networks.small.architecture import MEAN_SIZES_M, SmallOutputs
from wibam_core.networks.small.losses import LossWeights, lifted_loss
from wibam_core.networks.small.targets import Targets, encode
from wibam_core.training.losses import focal_loss

SIZES = torch.tensor(MEAN_SIZES_M)


def perfect(targets: Targets) -> SmallOutputs:
    """Maps that say exactly what the targets ask for at the taught cells."""
    batch, _, height, width = targets.heat.shape

    def draw(values: torch.Tensor) -> torch.Tensor:
        maps = torch.zeros(batch, values.shape[1], height, width)
        maps[targets.image, :, targets.cells[:, 1], targets.cells[:, 0]] = values
        return maps

    return SmallOutputs(
        torch.logit(targets.heat.clamp(1e-6, 1 - 1e-6)),
        draw(targets.box2d),
        draw(targets.centre3d),
        draw(targets.depth[:, None]),
        draw(targets.size),
        draw(targets.yaw),
        draw(targets.footprint),
        torch.zeros(batch, 5, height, width),
    )


@pytest.fixture
def targets() -> Targets:
    return encode([view_of(VEHICLES, camera(height_m=8.0, pitch_down_rad=0.35))])


def test_the_truth_costs_nothing(targets: Targets) -> None:
    parts = lifted_loss(perfect(targets), targets, SIZES, LossWeights())
    for name in ("box2d", "centre3d", "depth", "size", "yaw", "footprint", "corners", "scale"):
        assert parts[name].item() == pytest.approx(0.0, abs=1e-6), name
    assert parts["total"].item() == pytest.approx(sum(v.item() for k, v in parts.items() if k != "total"), rel=1e-6)


@pytest.mark.parametrize("name", ["box2d", "centre3d", "depth", "size", "yaw", "footprint", "heat"])
def test_every_error_costs(targets: Targets, name: str) -> None:
    truth = perfect(targets)
    wrong = replace(truth, **{name: getattr(truth, name) + 0.3})
    before = lifted_loss(truth, targets, SIZES, LossWeights())
    after = lifted_loss(wrong, targets, SIZES, LossWeights())
    assert after[name].item() > before[name].item() + 1e-3
    if name in ("centre3d", "yaw"):
        assert after["corners"].item() > before["corners"].item() + 1e-3
    if name == "size":  # a height must not pay for an error of place
        assert after["corners"].item() == pytest.approx(before["corners"].item(), abs=1e-9)


def test_vehicles_without_a_3d_label_teach_only_heat_and_2d_box(targets: Targets) -> None:
    view = view_of(VEHICLES, camera(height_m=8.0, pitch_down_rad=0.35))
    unknown = encode([replace(view, boxes3d=np.full((2, 7), np.nan))])
    outputs = perfect(targets)
    leaves = {name: getattr(outputs, name).clone().requires_grad_() for name in outputs.__dataclass_fields__}
    lifted_loss(SmallOutputs(**leaves), unknown, SIZES, LossWeights())["total"].backward()
    for name in ("centre3d", "depth", "size", "yaw", "footprint", "log_scale"):
        grad = leaves[name].grad
        assert grad is None or (grad == 0).all(), name
    assert (leaves["heat"].grad != 0).any()


def test_confidence_weighs_vehicles_against_each_other() -> None:
    view = view_of(VEHICLES, camera(height_m=8.0, pitch_down_rad=0.35))
    sure, unsure = (encode([replace(view, confidence=np.array([1.0, c]))]) for c in (1.0, 0.1))
    wrong = perfect(sure)
    wrong.depth[sure.image, :, sure.cells[:, 1], sure.cells[:, 0]] += (sure.vehicle == 1).float()[:, None]
    both = lifted_loss(wrong, sure, SIZES, LossWeights())["depth"].item()
    first = lifted_loss(wrong, unsure, SIZES, LossWeights())["depth"].item()
    assert both == pytest.approx(0.5, abs=1e-5)
    assert first == pytest.approx(0.1 / 1.1, abs=1e-5)


def test_either_heading_is_right_where_the_front_is_unknown(targets: Targets) -> None:
    view = view_of(VEHICLES, camera(height_m=8.0, pitch_down_rad=0.35))
    open_ended = encode([replace(view, front_known=np.array([False, True]))])
    turned = perfect(targets)
    sign = torch.where(targets.vehicle == 0, -1.0, 1.0)
    turned.yaw[targets.image, :, targets.cells[:, 1], targets.cells[:, 0]] *= sign[:, None]
    parts = lifted_loss(turned, open_ended, SIZES, LossWeights())
    assert parts["yaw"].item() == pytest.approx(0.0, abs=1e-6)
    assert parts["corners"].item() == pytest.approx(0.0, abs=1e-5)
    assert parts["scale"].item() == pytest.approx(0.0, abs=1e-5)
    known = lifted_loss(turned, targets, SIZES, LossWeights())
    assert known["yaw"].item() > 0.5


def test_focal_loss_is_that_of_the_formula() -> None:
    rng = np.random.default_rng(0)
    logits = rng.normal(0, 2, (2, 3, 4, 5))
    heat = rng.random((2, 3, 4, 5)) * 0.95
    heat[0, 1, 2, 3] = heat[1, 0, 0, 0] = 1.0
    judged = (rng.random((2, 1, 4, 5)) > 0.3).astype(float)
    judged[0, 0, 2, 3] = judged[1, 0, 0, 0] = 1.0
    p = 1 / (1 + np.exp(-logits))
    each = np.where(heat == 1, (1 - p) ** 2 * np.log(p), (1 - heat) ** 4 * p**2 * np.log(1 - p))
    loss = focal_loss(torch.tensor(logits), torch.tensor(heat), torch.tensor(judged))
    assert loss.item() == pytest.approx(-(each * judged).sum() / 2)


def test_an_empty_batch_has_a_finite_loss_and_gradient() -> None:
    empty = encode([view_of(np.zeros((0, 7)), camera())])
    outputs = perfect(empty)
    leaf = outputs.heat.clone().requires_grad_()
    loss = lifted_loss(replace(outputs, heat=leaf), empty, SIZES, LossWeights())["total"]
    loss.backward()
    assert torch.isfinite(loss)
    assert torch.isfinite(leaf.grad).all()
