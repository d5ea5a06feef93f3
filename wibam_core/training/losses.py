"""Losses that several networks share."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional


def focal_loss(logits: Tensor, heat: Tensor, judged: Tensor) -> Tensor:
    """Penalty-reduced focal loss per peak (Zhou et al. 2019, CenterNet, eq. 1: alpha 2, beta 4).

    ``logits`` and ``heat`` are (B, C, h, w); ``judged`` (B, 1, h, w) is 0 where cells do not count.
    """
    log_p, log_not_p = functional.logsigmoid(logits), functional.logsigmoid(-logits)
    p = logits.sigmoid()
    peak = (heat >= 1.0).to(logits.dtype)
    positive = peak * log_p * (1 - p).square()
    negative = (1 - peak) * log_not_p * p.square() * (1 - heat).pow(4)
    return -(judged * (positive + negative)).sum() / peak.sum().clamp_min(1.0)
