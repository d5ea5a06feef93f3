"""Peaks of heat maps."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from wibam_core.geometry.pixels import resized_px
from wibam_core.models.trunk import STRIDE

#: Of two peaks whose 2D boxes overlap more than this, the weaker is a duplicate.
DUPLICATE_IOU = 0.7


@dataclass(frozen=True)
class Peaks:
    """Local maxima of the heat: image (N,), cells (N, 2) x, y, classes (N,), scores (N,); best first per image."""

    image: Tensor
    cells: Tensor
    classes: Tensor
    scores: Tensor


def find_peaks(heat_logits: Tensor, min_score: float, top_k: int = 64) -> Peaks:
    """Peaks of heat (B, C, H, W): 3x3 local maxima over all classes together, at most ``top_k`` per image."""
    scores, classes = heat_logits.sigmoid().max(dim=1)
    is_peak = (functional.max_pool2d(scores[:, None], 3, 1, 1)[:, 0] == scores) & (scores >= min_score)
    flat = torch.where(is_peak, scores, scores.new_zeros(())).flatten(1)
    best, where = flat.topk(min(top_k, flat.shape[1]), dim=1)
    image, rank = (best > 0).nonzero(as_tuple=True)
    index = where[image, rank]
    width = scores.shape[2]
    cells = torch.stack([index % width, index // width], dim=-1)
    return Peaks(image, cells, classes.flatten(1)[image, index], best[image, rank])


def cell_centres_px(cells: Tensor) -> Tensor:
    """Input pixels (N, 2) of (possibly fractional) cells (N, 2)."""
    return resized_px(cells, STRIDE)
