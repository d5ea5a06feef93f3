"""An exported network made trainable again: batch normalisation is taken out of its convolutions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from wibam_core.errors import InvalidWeights

#: What the exported detector's module is called in its file (`wibam_core.models.detector2d.ExportedDetector2D`).
_WRAPPED = "detector"


def load_exported(path: Path, network: nn.Module, images: Tensor) -> None:
    """Give a network the weights of an ONNX file of `wibam_core.models.export`, in place.

    Exporting multiplies each normalisation into the convolution before it. What a convolution gives on ``images``,
    inputs of the network as they usually are, tells by what it is to be normalised, so that the network computes the
    same on them whether it trains or not. Residual blocks that the file lacks pass on what they get.

    Raises:
        InvalidWeights: a convolution or matrix of the file has no place in the network, or another shape.
    """
    graph = onnx.load(path).graph
    modules, parameters = dict(network.named_modules()), dict(network.named_parameters())
    values = {value.name: torch.from_numpy(numpy_helper.to_array(value).copy()) for value in graph.initializer}
    named = {_parameter_name(name): value for name, value in values.items()}
    multiplied = {
        _module_path(node.name): [values[name] for name in node.input[1:]]
        for node in graph.node
        if node.op_type in ("Conv", "MatMul") and node.input[1] in values
        if _parameter_name(node.input[1]) not in parameters
    }
    network.train()
    for name in modules:
        if name.endswith(".norm") and name.removesuffix("norm") + "second" not in multiplied:
            nn.init.zeros_(network.get_parameter(f"{name}.weight"))
    for name, parameter in parameters.items():
        if name in named:  # what nothing was multiplied into keeps its name
            _fill(parameter, named[name], name, path)
    hooks = []
    for name, (weight, *biases) in multiplied.items():
        # a linear layer's matrix is stored as its transpose, its bias by name
        _fill(parameters.get(f"{name}.weight"), weight if biases else weight.T, name, path)
        if biases:
            parent, _, last = name.rpartition(".")
            norm = modules[f"{parent}.norm" if last == "second" else f"{parent}.1"]
            hooks.append(norm.register_forward_pre_hook(_normalised_as(biases[0])))
    with torch.no_grad():
        network(images)
    for hook in hooks:
        hook.remove()


def _fill(parameter: nn.Parameter | None, value: Tensor, name: str, path: Path) -> None:
    if parameter is None or parameter.shape != value.shape:
        raise InvalidWeights(
            f"{path.name} holds weights {name!r} that the network does not have in this shape",
            hint="Go on from a network of the present shape, or train one anew without --start.",
        )
    with torch.no_grad():
        parameter.copy_(value)


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


def _parameter_name(stored: str) -> str:
    return stored.removeprefix(f"{_WRAPPED}.")


def _module_path(node: str) -> str:
    """``trunk.stages.1.1.first.0`` of ``/detector/trunk/stages.1/stages.1.1/first/first.0/Conv``."""
    path: list[str] = []
    for part in node.removeprefix(f"/{_WRAPPED}").split("/")[1:-1]:
        if path and part.startswith(path[-1] + "."):
            path[-1] = part
        else:
            path.append(part)
    return ".".join(path)
