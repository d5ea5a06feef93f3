"""Peaks of heat maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from wibam_core.geometry.iou import bev_iou
from wibam_core.geometry.pixels import resized_px
from wibam_core.models.trunk import STRIDE
from wibam_core.road_users import may_be_one

#: Of two peaks whose 2D boxes overlap more than this, the weaker is a duplicate.
DUPLICATE_IOU = 0.7
#: Of two vehicles of one image whose footprints overlap more than this (IoU), the weaker is part of the other: the
#: front and the rear of a pick-up, say, whose 2D boxes overlap little. Cars that touch do not overlap by so much.
FOOTPRINT_IOU = 0.1


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


def standing_apart(boxes: NDArray[np.float64], classes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices, ascending, of the boxes (N, 7) of one image, best first, that stand on no better one's place.

    Two road users cannot. Whoever walks or rides may overlap a vehicle: their boxes say little of how close they are.

    Args:
        boxes: in the world, finite.
        classes: (N,) indices into `CLASSES`.
    """
    over = (bev_iou(boxes, boxes) > FOOTPRINT_IOU) & may_be_one(classes, classes)
    kept = np.ones(len(boxes), dtype=bool)
    for index in range(len(boxes)):
        if kept[index]:
            kept[index + 1 :] &= ~over[index, index + 1 :]
    return np.flatnonzero(kept)
