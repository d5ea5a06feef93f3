"""Networks as single ONNX files."""

from __future__ import annotations

import json
from pathlib import Path

import onnx
import torch

from wibam_core.models.detector2d import Detector2D, ExportedDetector2D
from wibam_core.scene import CLASSES

_FAMILY = "wibam-centre"


def export_detector2d(detector: Detector2D, path: Path, width_px: int = 512, height_px: int = 288) -> None:
    """Write the 2D detector as one ONNX file, whole or not at all.

    Input ``image`` (1, 3, H, W) float32, BGR in 0..1, H and W multiples of 32 (dynamic). Outputs ``heat``
    (1, 4, H/4, W/4) and ``ltrb`` (1, 4, H/4, W/4): the box of cell (x, y) is ``((x + 0.5)·4 − 0.5, (y + 0.5)·4 − 0.5)``
    less and plus 4 times its distances. Metadata: ``family``, ``classes`` (a JSON list), ``stride``.
    """
    temporary = path.with_name(path.name + ".tmp")
    module = ExportedDetector2D(detector).eval()
    names = {2: "height", 3: "width"}
    torch.onnx.export(
        module,
        (torch.zeros(1, 3, height_px, width_px),),
        str(temporary),
        input_names=["image"],
        output_names=["heat", "ltrb"],
        dynamic_axes={"image": names},
        opset_version=18,
        dynamo=False,
    )
    model = onnx.load(str(temporary))
    metadata = {"family": _FAMILY, "classes": json.dumps([str(c) for c in CLASSES]), "stride": "4"}
    onnx.helper.set_model_props(model, metadata)
    onnx.checker.check_model(model)
    onnx.save(model, str(temporary))
    temporary.replace(path)
