"""Networks as single ONNX files."""

from __future__ import annotations

import copy
import io
import json
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import onnx
import torch
from torch import Tensor, nn

from wibam_core.models.detector2d import Detector2D, ExportedDetector2D
from wibam_core.models.edge_refiner import EdgeRefinerNetwork, EdgeRefinerOutputs
from wibam_core.models.taught import TAUGHT
from wibam_core.models.trunk import STRIDE

_DETECTOR_FAMILY = "wibam-centre"
_REFINER_FAMILY = "wibam-edges"
_OPSET = 18
#: What the TorchScript exporter says each time. The one that follows it gives the same maps to 6e-6, but takes 25 times
#: as long (4.0 s of CPU time instead of 0.16 s for the small network), needs two more packages, and warns of others.
_KNOWN_WARNINGS = ("You are using the legacy TorchScript-based ONNX export", "The feature will be removed")
_CLASSES = json.dumps([str(vehicle) for vehicle in TAUGHT])


def export_detector2d(detector: Detector2D, path: Path, width_px: int = 512, height_px: int = 288) -> None:
    """Write the 2D detector as one ONNX file, whole or not at all.

    Input ``image`` (1, 3, H, W) float32, BGR in 0..1, H and W multiples of 32 (dynamic). Outputs ``heat``
    (1, 4, H/4, W/4) and ``ltrb`` (1, 4, H/4, W/4): the box of cell (x, y) is ``((x + 0.5)·4 − 0.5, (y + 0.5)·4 − 0.5)``
    less and plus 4 times its distances. Metadata: ``family``, ``classes`` (a JSON list), ``stride``.
    """
    model = onnx_file(
        ExportedDetector2D(copy.deepcopy(detector).cpu()),
        torch.zeros(1, 3, height_px, width_px),
        ("heat", "ltrb"),
        {"image": {2: "height", 3: "width"}},
        {"family": _DETECTOR_FAMILY, "classes": _CLASSES, "stride": str(STRIDE)},
    )
    write_whole(model, path)


def export_edge_refiner(refiner: EdgeRefinerNetwork, path: Path, crop_px: int) -> None:
    """Write the edge refiner as one ONNX file, whole or not at all.

    Input ``image`` (B, 7, S, S); the outputs, each (B, 4), are named as the fields of `EdgeRefinerOutputs`. B is
    dynamic, S is ``crop_px``. Metadata: ``family``, ``classes`` (a JSON list), ``crop_px``.
    """
    outputs = EdgeRefinerOutputs._fields
    model = onnx_file(
        copy.deepcopy(refiner),
        torch.zeros(1, 7, crop_px, crop_px),
        outputs,
        {name: {0: "batch"} for name in ("image", *outputs)},
        {"family": _REFINER_FAMILY, "classes": _CLASSES, "crop_px": str(crop_px)},
    )
    write_whole(model, path)


def onnx_file(
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
    with _without_known_warnings():
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


@contextmanager
def _without_known_warnings() -> Iterator[None]:
    """Leave out what is known of the exporter; all other warnings are shown."""
    with warnings.catch_warnings():
        for message in _KNOWN_WARNINGS:
            warnings.filterwarnings("ignore", message, DeprecationWarning)
        yield


def write_whole(content: bytes, path: Path) -> None:
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_bytes(content)
    temporary.replace(path)
