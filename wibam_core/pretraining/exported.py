"""An exported detector made trainable again: batch normalisation is taken out of its convolutions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from wibam_core.errors import InvalidWeights
from wibam_core.models.detector2d import Detector2D


def load_exported(path: Path, network: Detector2D, images: Tensor) -> None:
    """Give a network the weights of an ONNX file of `export_detector2d`, in place.

    Exporting multiplies each normalisation into the convolution before it. What a convolution gives on ``images``
    (B, 3, H, W), BGR in 0..1, tells by what it is to be normalised, so that the network computes the same on them
    whether it trains or not. Residual blocks that the file lacks pass on what they get.

    Raises:
        InvalidWeights: a convolution of the file has no place in the network, or another shape.
    """
    model = onnx.load(path)
    values = {value.name: torch.from_numpy(numpy_helper.to_array(value).copy()) for value in model.graph.initializer}
    found = {
        _module_path(node.name): (values[node.input[1]], values[node.input[2]])
        for node in model.graph.node
        if node.op_type == "Conv"
    }
    modules = dict(network.named_modules())
    network.train()
    hooks = []
    for name, module in modules.items():
        if name.endswith(".norm") and name.removesuffix("norm") + "second" not in found:
            nn.init.zeros_(module.get_parameter("weight"))
    for name, (weight, bias) in found.items():
        conv = modules.get(name)
        if not isinstance(conv, nn.Conv2d) or conv.weight.shape != weight.shape:
            raise InvalidWeights(
                f"{path.name} holds a convolution {name!r} that the detector does not have",
                hint="Go on from a detector of the present shape, or train one anew without --start.",
            )
        with torch.no_grad():
            conv.weight.copy_(weight)
            if conv.bias is not None:
                conv.bias.copy_(bias)
                continue
        parent, _, last = name.rpartition(".")
        norm = modules[f"{parent}.norm" if last == "second" else f"{parent}.1"]
        hooks.append(norm.register_forward_pre_hook(_normalised_as(bias)))
    with torch.no_grad():
        network(images)
    for hook in hooks:
        hook.remove()


def _normalised_as(bias: Tensor) -> Callable[[nn.Module, tuple[Tensor]], None]:
    """A hook by which a normalisation learns to give back what it gets, and ``bias`` more."""

    def take_over(norm: nn.Module, inputs: tuple[Tensor]) -> None:
        assert isinstance(norm, nn.BatchNorm2d)
        assert norm.running_mean is not None
        assert norm.running_var is not None
        var, mean = torch.var_mean(inputs[0], dim=(0, 2, 3), correction=0)
        norm.running_mean.copy_(mean)
        norm.running_var.copy_(var)
        norm.weight.copy_((var + norm.eps).sqrt())
        norm.bias.copy_(mean + bias)

    return take_over


def _module_path(node: str) -> str:
    """``trunk.stages.1.1.first.0`` of ``/detector/trunk/stages.1/stages.1.1/first/first.0/Conv``."""
    path: list[str] = []
    for part in node.split("/")[2:-1]:
        if path and part.startswith(path[-1] + "."):
            path[-1] = part
        else:
            path.append(part)
    return ".".join(path)
