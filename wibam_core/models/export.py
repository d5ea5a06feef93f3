"""Networks as single ONNX files."""

from __future__ import annotations

import copy
import io
import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import onnx
import torch
from torch import Tensor, nn

from wibam_core.models.detector2d import Detector2D, ExportedDetector2D
from wibam_core.models.refiner2d import Refiner2D, RefinerOutputs
from wibam_core.models.small import REFERENCE_FOCAL_PX, UNCERTAINTY_GROUPS, SmallNetwork, SmallOutputs
from wibam_core.models.trunk import INPUT_MULTIPLE, STRIDE
from wibam_core.models.usage import Usage, input_width_metadata
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

_DETECTOR_FAMILY = "wibam-centre"
_REFINER_FAMILY = "wibam-edges"
_SMALL_FAMILY = "wibam-mono"
_OPSET = 18
_CLASSES = json.dumps([str(vehicle) for vehicle in CLASSES])


class _SmallMaps(nn.Module):
    """The small network with its maps as a tuple, in the order of `SMALL_CHANNELS`."""

    def __init__(self, network: SmallNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        outputs: SmallOutputs = self.network(images)
        return tuple(getattr(outputs, name) for name in SMALL_CHANNELS)


def export_detector2d(detector: Detector2D, path: Path, width_px: int = 512, height_px: int = 288) -> None:
    """Write the 2D detector as one ONNX file, whole or not at all.

    Input ``image`` (1, 3, H, W) float32, BGR in 0..1, H and W multiples of 32 (dynamic). Outputs ``heat``
    (1, 4, H/4, W/4) and ``ltrb`` (1, 4, H/4, W/4): the box of cell (x, y) is ``((x + 0.5)·4 − 0.5, (y + 0.5)·4 − 0.5)``
    less and plus 4 times its distances. Metadata: ``family``, ``classes`` (a JSON list), ``stride``.
    """
    model = _onnx(
        ExportedDetector2D(copy.deepcopy(detector).cpu()),
        torch.zeros(1, 3, height_px, width_px),
        ("heat", "ltrb"),
        {"image": {2: "height", 3: "width"}},
        {"family": _DETECTOR_FAMILY, "classes": _CLASSES, "stride": str(STRIDE)},
    )
    _write(model, path)


def export_refiner2d(refiner: Refiner2D, path: Path, crop_px: int) -> None:
    """Write the edge refiner as one ONNX file, whole or not at all.

    Input ``image`` (B, 7, S, S); the outputs, each (B, 4), are named as the fields of `RefinerOutputs`. B is dynamic,
    S is ``crop_px``. Metadata: ``family``, ``classes`` (a JSON list), ``crop_px``.
    """
    outputs = RefinerOutputs._fields
    model = _onnx(
        copy.deepcopy(refiner),
        torch.zeros(1, 7, crop_px, crop_px),
        outputs,
        {name: {0: "batch"} for name in ("image", *outputs)},
        {"family": _REFINER_FAMILY, "classes": _CLASSES, "crop_px": str(crop_px)},
    )
    _write(model, path)


def export_small(network: SmallNetwork, path: Path, usage: Usage | None = None) -> None:
    """Write the small network as one ONNX file, whole or not at all; see `small_onnx`."""
    _write(small_onnx(network, usage), path)


def small_onnx(network: SmallNetwork, usage: Usage | None = None) -> bytes:
    """The small network, in evaluation mode, as an ONNX file. It may be on any device and stays as it is.

    Input ``image`` (B, 3, H, W) float32, BGR in 0..1, H and W multiples of 32; B, H and W are dynamic. One output per
    field of `SmallOutputs`, with its name: float32 maps (B, C, H/4, W/4) as the heads give them, heat as logits.
    Metadata: `small_metadata`; ``input_width_px``, the width that images are resized to; ``mean_sizes_m``, the classes'
    mean lengths, widths and heights in m (JSON); where ``usage`` is given, ``decode`` and ``sd_factors``, see `Usage`.
    """
    grid = {0: "batch", 2: "rows", 3: "columns"}
    return _onnx(
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
        "family": _SMALL_FAMILY,
        "classes": _CLASSES,
        "stride": str(STRIDE),
        "reference_focal_px": str(REFERENCE_FOCAL_PX),
        "uncertainty_groups": json.dumps(UNCERTAINTY_GROUPS),
    }


def _onnx(
    module: nn.Module,
    example: Tensor,
    outputs: tuple[str, ...],
    dynamic_axes: Mapping[str, Mapping[int, str]],
    metadata: Mapping[str, str],
) -> bytes:
    """A checked ONNX file with the one input ``image``.

    Args:
        module: gives a tuple of tensors; put into evaluation mode.
        example: an input, of any size that the module takes.
        outputs: names of what it gives.
        dynamic_axes: name of an input or output -> axis -> name of its size.
        metadata: what the file says about itself.
    """
    buffer = io.BytesIO()
    torch.onnx.export(
        module.eval(),
        (example,),
        buffer,  # type: ignore[arg-type]  # this exporter writes to open files, too
        input_names=["image"],
        output_names=list(outputs),
        dynamic_axes=dynamic_axes,
        opset_version=_OPSET,
        dynamo=False,
    )
    model = onnx.load_from_string(buffer.getvalue())
    onnx.helper.set_model_props(model, dict(metadata))
    onnx.checker.check_model(model)
    content: bytes = model.SerializeToString()
    return content


def _write(content: bytes, path: Path) -> None:
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_bytes(content)
    temporary.replace(path)
