"""Losses that several networks share."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from wibam_core.geometry.box3d import XY
from wibam_core.geometry.torch_ops import corners

#: Corners of a ground rectangle: the bottom four of a box.
_BOTTOM = slice(0, 4)
#: Boxes decoded farther off than this, along rays close to the horizon, teach nothing.
_MAX_CORNER_RANGE_M = 150.0


def focal_loss(logits: Tensor, heat: Tensor, judged: Tensor) -> Tensor:
    """Penalty-reduced focal loss per peak (Zhou et al. 2019, CenterNet, eq. 1: alpha 2, beta 4).

    ``logits`` and ``heat`` are (B, C, h, w); ``judged`` (B, C or 1, h, w) is 0 where cells do not count.
    """
    log_p, log_not_p = functional.logsigmoid(logits), functional.logsigmoid(-logits)
    p = logits.sigmoid()
    peak = (heat >= 1.0).to(logits.dtype)
    positive = peak * log_p * (1 - p).square()
    negative = (1 - peak) * log_not_p * p.square() * (1 - heat).pow(4)
    return -(judged * (positive + negative)).sum() / peak.sum().clamp_min(1.0)


def corner_loss(predicted: Tensor, labelled: Tensor) -> Tensor:
    """(N,) mean smooth L1 between the ground corners of boxes (N, 7), m; 0 for boxes that are decoded far away."""
    ours, theirs = (corners(boxes)[:, _BOTTOM, XY] for boxes in (predicted, labelled))
    far = (ours - theirs).detach().abs().amax(dim=(1, 2)) > _MAX_CORNER_RANGE_M
    error = functional.smooth_l1_loss(ours, theirs, reduction="none").mean(dim=(1, 2))
    return torch.where(far, torch.zeros_like(error), error)
