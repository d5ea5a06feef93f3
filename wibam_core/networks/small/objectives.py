"""The ways to learn from multi-view boxes, as losses of a batch of views."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from wibam_core.config import FinetuneConfig
from wibam_core.networks.small.architecture import SmallOutputs
from wibam_core.networks.small.decode import boxes3d, gather
from wibam_core.networks.small.losses import LossWeights, box2d_loss, lifted_loss
from wibam_core.networks.small.targets import Targets
from wibam_core.placing import Decode
from wibam_core.training.losses import focal_loss
from wibam_core.training.multiview import DEFAULT_MULTIVIEW_WEIGHT, OtherViews, multiview_loss

#: Headings and sizes are what a box's place is fitted by, and small numbers beside offsets in cells.
_LIFTED_WEIGHTS = LossWeights(yaw=4.0, size=3.0)


@dataclass(frozen=True)
class LiftedObjective:
    """Learn from the fits to all views: `wibam_core.networks.small.losses.lifted_loss`."""

    decode: Decode

    def __call__(
        self, outputs: SmallOutputs, targets: Targets, mean_sizes_m: Tensor, others: OtherViews
    ) -> dict[str, Tensor]:
        return lifted_loss(outputs, targets, mean_sizes_m, _LIFTED_WEIGHTS, self.decode)


@dataclass(frozen=True)
class PaperObjective:
    """The published loss (Howe et al. 2021, eq. 1): the focal loss of the centres plus the multi-view loss.

    Attributes:
        decode: how boxes are placed along the ray.
        box_heads: also learn the centre offset and the size of the 2D boxes by L1, as the published code does; weighted
            as in the lifted loss.
    """

    decode: Decode
    box_heads: bool = False

    def __call__(
        self, outputs: SmallOutputs, targets: Targets, mean_sizes_m: Tensor, others: OtherViews
    ) -> dict[str, Tensor]:
        parts = {
            "heat": focal_loss(outputs.heat, targets.heat, targets.judged).double(),
            "multiview": _multiview(outputs, targets, mean_sizes_m, others, self.decode),
        }
        if self.box_heads:
            values = gather(outputs, targets.image, targets.cells, targets.classes)
            parts["box2d"] = _LIFTED_WEIGHTS.box2d * box2d_loss(values, targets)
        return {**parts, "total": torch.stack(list(parts.values())).sum()}


@dataclass(frozen=True)
class CombinedObjective:
    """The lifted loss plus ``multiview_weight`` times the multi-view loss."""

    decode: Decode
    multiview_weight: float

    def __call__(
        self, outputs: SmallOutputs, targets: Targets, mean_sizes_m: Tensor, others: OtherViews
    ) -> dict[str, Tensor]:
        lifted = lifted_loss(outputs, targets, mean_sizes_m, _LIFTED_WEIGHTS, self.decode)
        multiview = self.multiview_weight * _multiview(outputs, targets, mean_sizes_m, others, self.decode)
        return {**lifted, "multiview": multiview, "total": lifted["total"] + multiview}


Objective = LiftedObjective | PaperObjective | CombinedObjective


def objective_of(config: FinetuneConfig) -> Objective:
    """The loss that the options ask for."""
    if config.method == "lifted":
        return LiftedObjective(config.decode)
    if config.method == "paper":
        return PaperObjective(config.decode, config.box_heads)
    weight = DEFAULT_MULTIVIEW_WEIGHT if config.multiview_weight is None else config.multiview_weight
    return CombinedObjective(config.decode, weight)


def _multiview(
    outputs: SmallOutputs, targets: Targets, mean_sizes_m: Tensor, others: OtherViews, decode: Decode
) -> Tensor:
    """The multi-view loss of the boxes that the heads give at the centres of the vehicles' automatic boxes."""
    rows = targets.centre.nonzero()[:, 0]
    values = gather(outputs, targets.image[rows], targets.cells[rows], targets.classes[rows])
    boxes = boxes3d(values, targets.cameras, mean_sizes_m, decode)
    return multiview_loss(boxes, others.of_vehicles(targets.vehicle[rows]))
