"""The small network as a single ONNX file."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from dataclasses import fields

import torch
from torch import Tensor, nn

from wibam_core.documents.model_card import ModelCard
from wibam_core.formats.model_card import metadata_of
from wibam_core.models.export import onnx_file
from wibam_core.models.trunk import INPUT_MULTIPLE, STRIDE
from wibam_core.networks.small.architecture import REFERENCE_FOCAL_PX, UNCERTAINTY_GROUPS, SmallNetwork, SmallOutputs

#: What every file says of its outputs: px of the input per cell; the focal length, in px of the resized image, that the
#: depths belong to; the names of the channels of ``log_scale`` (JSON).
OUTPUT_FACTS = {
    "stride": str(STRIDE),
    "reference_focal_px": str(REFERENCE_FOCAL_PX),
    "uncertainty_groups": json.dumps(UNCERTAINTY_GROUPS),
}


def channels(classes: int) -> Mapping[str, int]:
    """The outputs in a file, named as the fields of `SmallOutputs`, and how many channels each has."""
    return {
        "heat": classes,
        "box2d": 4,
        "centre3d": 2,
        "depth": 1,
        "size": 3,
        "yaw": 2,
        "footprint": 2,
        "log_scale": len(UNCERTAINTY_GROUPS),
    }


class _SmallMaps(nn.Module):
    """The small network with its maps as a tuple, in the order of the fields of `SmallOutputs`."""

    def __init__(self, network: SmallNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        outputs: SmallOutputs = self.network(images)
        return tuple(getattr(outputs, field.name) for field in fields(outputs))


def small_onnx(network: SmallNetwork, card: ModelCard) -> bytes:
    """The small network, in evaluation mode, as an ONNX file. It may be on any device and stays as it is.

    Input ``image`` (B, 3, H, W) float32, BGR in 0..1, H and W multiples of 32; B, H and W are dynamic. One output per
    field of `SmallOutputs`, with its name: float32 maps (B, C, H/4, W/4) as the heads give them, heat as logits.
    Metadata: the card, see `wibam_core.formats.model_card.metadata_of`; `OUTPUT_FACTS`; ``mean_sizes_m``, the classes'
    mean lengths, widths and heights in m (JSON).
    """
    outputs = tuple(channels(len(card.classes)))
    grid = {0: "batch", 2: "rows", 3: "columns"}
    return onnx_file(
        _SmallMaps(copy.deepcopy(network).cpu()),
        torch.zeros(1, 3, 2 * INPUT_MULTIPLE, 2 * INPUT_MULTIPLE),
        outputs,
        {"image": {0: "batch", 2: "height", 3: "width"}, **dict.fromkeys(outputs, grid)},
        {**metadata_of(card), **OUTPUT_FACTS, "mean_sizes_m": json.dumps(network.mean_sizes_m.tolist())},
    )
