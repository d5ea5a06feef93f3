"""Losses of DLA-34: CenterTrack's own under pseudo-labels (fits to all views), and the published multi-view loss."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from wibam_core.geometry.box3d import SIZE
from wibam_core.geometry.torch_ops import focal_px, wrap_angle
from wibam_core.networks.dla34.centertrack import (
    BIN_CENTRES_RAD,
    TRAINED_FOCAL_PX,
    HeadValues,
    alphas_rad,
    boxes3d,
    depths_m,
    read_heads,
)
from wibam_core.networks.dla34.targets import DLA34Targets
from wibam_core.placing import Decode
from wibam_core.training.losses import corner_loss, focal_loss
from wibam_core.training.multiview import OtherViews, multiview_loss

#: Half the width of the bins of alpha: they overlap, so that no heading is at the border of both (Mousavian et al.
#: 2017; Zhou et al. 2019, CenterNet).
_BIN_REACH_RAD = 2 * torch.pi / 3


@dataclass(frozen=True)
class DLA34Weights:
    """Weights of the parts: CenterTrack's (Zhou et al. 2020), and that of the decoded box's ground corners (per m)."""

    heat: float = 1.0
    reg: float = 1.0
    wh: float = 0.1
    amodel_offset: float = 1.0
    dep: float = 1.0
    dim: float = 1.0
    rot: float = 1.0
    corners: float = 0.5


_WEIGHTS = DLA34Weights()


def heat_part(heads: Mapping[str, Tensor], targets: DLA34Targets, channels: Sequence[int]) -> Tensor:
    """The focal loss of the channels that find road users, on the heads' device; others learn nothing."""
    logits = heads["hm"][:, channels]
    heat, judged, asked = (of.to(logits.device) for of in (targets.heat, targets.judged, targets.asked))
    return focal_loss(logits, heat, judged * asked).cpu().double()


def box2d_parts(values: HeadValues, targets: DLA34Targets) -> dict[str, Tensor]:
    """L1 of the 2D boxes' centres and sizes, cells, weighted."""
    count = max(len(targets.cells), 1)
    return {
        "reg": _WEIGHTS.reg * (values.centre2d - targets.centre2d).abs().sum() / count,
        "wh": _WEIGHTS.wh * (values.wh - targets.wh).abs().sum() / count,
    }


def lifted_parts(values: HeadValues, targets: DLA34Targets, decode: Decode) -> dict[str, Tensor]:
    """The parts that need a 3D box to learn from, weighted, by its confidence.

    Where a label does not tell front from rear, the heading nearer to the network's own counts.
    """
    norm = targets.lifted.sum().clamp_min(1.0)
    turned = ~targets.front_known & ((alphas_rad(values.rot).detach() - targets.alpha_rad).cos() < 0)
    turn = torch.pi * turned
    seen_by = targets.cameras[targets.image]
    trained_scale = TRAINED_FOCAL_PX / focal_px(seen_by)
    offset = (values.centre3d - values.centre2d) - (targets.centre3d - targets.centre2d)
    placed = replace(values, size_m=targets.boxes3d[:, SIZE])  # else heights learn to make up for errors of place
    labelled = targets.boxes3d + functional.pad(turn[:, None], (6, 0))
    errors = {
        "amodel_offset": offset.abs().sum(dim=1),
        "dep": (depths_m(values.dep, seen_by) - targets.depth_m).abs() * trained_scale,
        "dim": (values.size_m - targets.boxes3d[:, SIZE]).abs().sum(dim=1),
        "rot": _bin_loss(values.rot, targets.alpha_rad + turn),
        "corners": corner_loss(boxes3d(placed, targets.cameras, decode), labelled),
    }
    return {name: getattr(_WEIGHTS, name) * (error * targets.lifted).sum() / norm for name, error in errors.items()}


def _bin_loss(rot: Tensor, alpha_rad: Tensor) -> Tensor:
    """(N,) cross entropy of "alpha lies in this bin", and L1 of sin and cos from the middle of the bins it lies in."""
    loss = torch.zeros_like(alpha_rad)
    for start, centre in zip((0, 4), BIN_CENTRES_RAD, strict=True):
        angle = wrap_angle(alpha_rad - centre)
        inside = angle.abs() <= _BIN_REACH_RAD
        within = (rot[:, start + 2] - angle.sin()).abs() + (rot[:, start + 3] - angle.cos()).abs()
        said = functional.cross_entropy(rot[:, start : start + 2], inside.long(), reduction="none")
        loss = loss + said + inside * within
    return loss


def multiview_part(values: HeadValues, targets: DLA34Targets, others: OtherViews, decode: Decode) -> Tensor:
    """The published loss (Howe et al. 2021, eq. 1) of the boxes at the centres of the vehicles' automatic boxes."""
    return multiview_loss(boxes3d(values, targets.cameras, decode), others.of_vehicles(targets.vehicle))


def values_at(heads: Mapping[str, Tensor], targets: DLA34Targets) -> HeadValues:
    """What the heads say at the targets' cells."""
    return read_heads(heads, targets.image, targets.cells)
