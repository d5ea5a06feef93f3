"""Losses of the small network."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from wibam_core.geometry.box3d import YAW
from wibam_core.geometry.torch_ops import wrap_angle
from wibam_core.networks.small.architecture import SmallOutputs
from wibam_core.networks.small.decode import PeakValues, boxes3d, gather
from wibam_core.networks.small.targets import Targets
from wibam_core.placing import Decode
from wibam_core.training.losses import corner_loss, focal_loss


@dataclass(frozen=True)
class LossWeights:
    """Weights of the parts of `lifted_loss`; ``corners`` is that of the decoded box's ground corners."""

    heat: float = 1.0
    box2d: float = 0.2
    centre3d: float = 1.0
    depth: float = 1.0
    size: float = 1.0
    yaw: float = 1.0
    footprint: float = 1.0
    corners: float = 0.5
    scale: float = 0.05


def box2d_loss(values: PeakValues, targets: Targets) -> Tensor:
    """Mean over taught cells of the L1 errors of the 2D box: its centre's offset and its log size."""
    return (values.box2d - targets.box2d.double()).abs().sum() / max(len(targets.cells), 1)


def lifted_loss(
    outputs: SmallOutputs, targets: Targets, mean_sizes_m: Tensor, weights: LossWeights, decode: Decode = "plane"
) -> dict[str, Tensor]:
    """The parts of the loss, weighted, and their sum as ``total``.

    Vehicles without a 3D box to learn from teach the heat and the 2D box; the others also centre, footprint, depth,
    size, yaw and the ground corners of the decoded box (smooth L1, m), all by their confidence. Where a box does not
    tell front from rear, the heading nearer to the network's own counts.
    """
    values = gather(outputs, targets.image, targets.cells, targets.classes)
    lifted = targets.lifted.double()
    norm = lifted.sum().clamp_min(1.0)
    sign = _heading_signs(values, targets)

    def l1(value: Tensor, target: Tensor) -> Tensor:
        error = (value - target.double()).abs()
        return ((error.sum(dim=1) if error.dim() > 1 else error) * lifted).sum() / norm

    parts = {
        "heat": focal_loss(outputs.heat, targets.heat, targets.judged),
        "box2d": box2d_loss(values, targets),
        "centre3d": l1(values.centre3d, targets.centre3d),
        "depth": l1(values.depth, targets.depth),
        "size": l1(values.size, targets.size),
        "yaw": l1(values.yaw, targets.yaw * sign[:, None]),
        "footprint": l1(values.footprint, targets.footprint),
        "scale": (_scale_loss(values, targets, sign) * lifted).sum() / norm,
    }
    if weights.corners > 0:
        placed = replace(values, size=targets.size.double())  # else sizes learn to make up for errors of place
        predicted = boxes3d(placed, targets.cameras, mean_sizes_m, decode)
        parts["corners"] = (corner_loss(predicted, _turned(targets.boxes3d, sign)) * lifted).sum() / norm
    weighted = {name: part * getattr(weights, name) for name, part in parts.items()}
    return {**weighted, "total": torch.stack([part.double() for part in weighted.values()]).sum()}


def _heading_signs(values: PeakValues, targets: Targets) -> Tensor:
    """(N,) −1 where the label's front is unknown and the network takes its rear for it, else 1."""
    agreement = (values.yaw.detach() * targets.yaw.double()).sum(dim=1)
    turned = ~targets.front_known & (agreement < 0)
    return torch.where(turned, -1.0, 1.0).double()


def _turned(boxes: Tensor, sign: Tensor) -> Tensor:
    """Boxes (N, 7), turned round where ``sign`` (N,) is −1."""
    turn = torch.zeros_like(boxes)
    turn[:, YAW] = torch.pi * (sign < 0)
    return boxes + turn


def _scale_loss(values: PeakValues, targets: Targets, sign: Tensor) -> Tensor:
    """(N,) Laplace negative log-likelihood of the errors, which are held fixed: it teaches the scales alone."""
    wanted = targets.yaw * sign[:, None]
    angle = torch.atan2(values.yaw[:, 0], values.yaw[:, 1]) - torch.atan2(wanted[:, 0], wanted[:, 1])
    errors = torch.stack(
        [
            (values.centre3d - targets.centre3d).abs().mean(dim=1),
            (values.depth - targets.depth).abs(),
            (values.size - targets.size).abs().mean(dim=1),
            wrap_angle(angle).abs(),
            (values.footprint - targets.footprint).abs().mean(dim=1),
        ],
        dim=1,
    ).detach()
    log_scale = values.log_scale.clamp(-6.0, 3.0)
    return (errors * torch.exp(-log_scale) + log_scale).sum(dim=1)
