"""The small network as a single ONNX file."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from types import MappingProxyType

import torch
from torch import Tensor, nn

from wibam_core.models.export import onnx_file, write_whole
from wibam_core.models.trunk import INPUT_MULTIPLE, STRIDE
from wibam_core.models.usage import Usage, input_width_metadata
from wibam_core.networks.small.architecture import REFERENCE_FOCAL_PX, UNCERTAINTY_GROUPS, SmallNetwork, SmallOutputs
from wibam_core.road_users import CLASSES

#: The small network's outputs in a file, named as the fields of `SmallOutputs`, and how many channels each has.
SMALL_CHANNELS = MappingProxyType(
    {
        "heat": len(CLASSES),
        "box2d": 4,
        "centre3d": 2,
        "depth": 1,
        "size": 3,
        "yaw": 2,
        "footprint": 2,
        "log_scale": len(UNCERTAINTY_GROUPS),
    }
)

_FAMILY = "wibam-mono"


class _SmallMaps(nn.Module):
    """The small network with its maps as a tuple, in the order of `SMALL_CHANNELS`."""

    def __init__(self, network: SmallNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        outputs: SmallOutputs = self.network(images)
        return tuple(getattr(outputs, name) for name in SMALL_CHANNELS)


def export_small(network: SmallNetwork, path: Path, usage: Usage | None = None) -> None:
    """Write the small network as one ONNX file, whole or not at all; see `small_onnx`."""
    write_whole(small_onnx(network, usage), path)


def small_onnx(network: SmallNetwork, usage: Usage | None = None) -> bytes:
    """The small network, in evaluation mode, as an ONNX file. It may be on any device and stays as it is.

    Input ``image`` (B, 3, H, W) float32, BGR in 0..1, H and W multiples of 32; B, H and W are dynamic. One output per
    field of `SmallOutputs`, with its name: float32 maps (B, C, H/4, W/4) as the heads give them, heat as logits.
    Metadata: `small_metadata`; ``input_width_px``, the width that images are resized to; ``mean_sizes_m``, the classes'
    mean lengths, widths and heights in m (JSON); where ``usage`` is given, ``decode`` and ``sd_factors``, see `Usage`.
    """
    grid = {0: "batch", 2: "rows", 3: "columns"}
    return onnx_file(
        _SmallMaps(copy.deepcopy(network).cpu()),
        torch.zeros(1, 3, 2 * INPUT_MULTIPLE, 2 * INPUT_MULTIPLE),
        tuple(SMALL_CHANNELS),
        {"image": {0: "batch", 2: "height", 3: "width"}, **dict.fromkeys(SMALL_CHANNELS, grid)},
        {
            **small_metadata(),
            **input_width_metadata(network.input_width_px),
            "mean_sizes_m": json.dumps(network.mean_sizes_m.tolist()),
            **({} if usage is None else usage.metadata()),
        },
    )


def small_metadata() -> dict[str, str]:
    """What every ONNX file of the small network says about itself; lists are JSON.

    ``reference_focal_px`` is the focal length, in px of the resized image, that the depths belong to.
    ``uncertainty_groups`` names the channels of ``log_scale``.
    """
    return {
        "family": _FAMILY,
        "classes": json.dumps([str(vehicle) for vehicle in CLASSES]),
        "stride": str(STRIDE),
        "reference_focal_px": str(REFERENCE_FOCAL_PX),
        "uncertainty_groups": json.dumps(UNCERTAINTY_GROUPS),
    }
