"""Weights as safetensors files, checked against the network before anything is loaded."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

import torch
from safetensors.torch import load_file, save
from torch import Tensor, nn

from wibam_core.errors import InvalidWeights


def load_state(module: nn.Module, path: Path) -> None:
    """Load the tensors of a safetensors file into a network, and put it into evaluation mode.

    Raises:
        InvalidWeights: naming the first tensor that does not fit.
    """
    state = load_file(str(path))
    check_state(path.name, state, module.state_dict(), None)
    module.load_state_dict(state)
    module.eval()


def save_state(state: Mapping[str, Tensor], path: Path, metadata: Mapping[str, str]) -> None:
    """Write tensors, on any device, to a safetensors file, whole or not at all; the same give the same bytes."""
    held = {name: value.detach().cpu().contiguous() for name, value in state.items()}
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_bytes(_with_sorted_header(save(held, metadata=dict(metadata))))
    temporary.replace(path)


def check_state(source: str, state: Mapping[str, Tensor], expected: Mapping[str, Tensor], hint: str | None) -> None:
    """Check that tensors have a network's names, shapes and types, and that their values are finite.

    Args:
        source: name of the file that ``state`` was read from.
        state: name -> tensor.
        expected: the network's own.
        hint: what to do where something does not fit; None for the usual one.

    Raises:
        InvalidWeights: naming the first thing that does not fit.
    """

    def refused(what: str, tensor: str) -> InvalidWeights:
        return InvalidWeights(f"{source}{what}", hint=hint, tensor=tensor)

    for name, value in expected.items():
        if name not in state:
            raise refused(f" lacks the tensor {name}", name)
        if state[name].shape != value.shape:
            raise refused(f": tensor {name} has shape {tuple(state[name].shape)}, not {tuple(value.shape)}", name)
        if state[name].dtype != value.dtype:
            raise refused(f": tensor {name} is {state[name].dtype}, not {value.dtype}", name)
        if not _is_finite(state[name]):
            raise refused(f": tensor {name} has values that are not finite", name)
    for name in state:
        if name not in expected:
            raise refused(f" has a tensor {name} that the network lacks", name)


def _is_finite(values: Tensor) -> bool:
    # The extremes are NaN where any value is; looking at them is several times faster than at a mask of all values.
    return bool(torch.stack(values.aminmax()).isfinite().all())


def _with_sorted_header(file: bytes) -> bytes:
    """A safetensors file with its metadata in order of the keys; the library writes them in any order.

    The format: the header's length, 8 bytes little-endian, the header as JSON, padded with blanks to a multiple of 8,
    then the tensors, at offsets counted from the header's end.
    """
    length = int.from_bytes(file[:8], "little")
    header = json.loads(file[8 : 8 + length])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + file[8 + length :]


def bundled(name: str) -> Path:
    """A file that ships with the package: ``mono_small.safetensors`` or ``detector2d.onnx``.

    Raises:
        InvalidWeights: where there is no such file.
    """
    path = Path(str(resources.files("wibam_core.models") / "bundled" / name))
    if not path.is_file():
        raise InvalidWeights(f"no weights named {name} ship with this package")
    return path
