"""Weights as safetensors files, checked against the network before anything is loaded."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

import safetensors
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from wibam_core.errors import InvalidWeights
from wibam_core.models.usage import DLA34_DECODES, SMALL_DECODES, Usage, input_width_metadata, read_input_width
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.dla34.centertrack import NUSCENES_CLASSES
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.road_users import CLASSES

_FAMILY = "wibam-small"
_VERSION = "1"
_CENTERTRACK_FAMILY = "centertrack-dla34"
_CENTERTRACK_VERSION = "1"

_NOT_SAFETENSORS_HINT = (
    "Give a safetensors file made for this network. `wibam weights convert` makes one of CenterTrack's .pth or WIBAM's "
    ".ckpt."
)

#: A network that finds 3D vehicles in one image.
Monocular = SmallNetwork | DLA34

_Network = TypeVar("_Network", bound=nn.Module)


def metadata() -> dict[str, str]:
    """What a weights file says about itself."""
    return {"family": _FAMILY, "version": _VERSION, "classes": ",".join(CLASSES)}


def centertrack_metadata() -> dict[str, str]:
    """What a file of converted CenterTrack weights says about itself, apart from where they come from."""
    return {"family": _CENTERTRACK_FAMILY, "version": _CENTERTRACK_VERSION, "classes": ",".join(NUSCENES_CLASSES)}


def save_network(network: Monocular, path: Path, origin: Mapping[str, str] = MappingProxyType({})) -> None:
    """Write ``network`` to a safetensors file, whole or not at all.

    Args:
        network: of either family, on any device.
        path: of the file.
        origin: what else the file is to say about itself, see `origin_of` and `Usage.metadata`.
    """
    temporary = path.with_name(path.name + ".tmp")
    state = {name: value.detach().cpu().contiguous() for name, value in network.state_dict().items()}
    if isinstance(network, DLA34):
        said = centertrack_metadata()
    else:
        said = metadata() | input_width_metadata(network.input_width_px)
    save_file(state, str(temporary), metadata={**origin, **said})
    temporary.replace(path)


def origin_of(path: Path) -> dict[str, str]:
    """What a weights file says about where it comes from and its licence, to be said of what is made of it, too."""
    return {key: value for key, value in _read_metadata(path).items() if key not in metadata()}


def usage_of(path: Path) -> Usage:
    """How the network in a weights file is to be used.

    Raises:
        InvalidWeights: the file says what cannot be, or cannot be read.
    """
    said = _read_metadata(path)
    return Usage.of(path.name, said, DLA34_DECODES if said.get("family") == _CENTERTRACK_FAMILY else SMALL_DECODES)


def load_network(path: Path) -> SmallNetwork:
    """A network in evaluation mode.

    Raises:
        InvalidWeights: naming the first thing that does not fit.
    """
    _check_metadata(path, metadata())
    network = _loaded(SmallNetwork(), path)
    network.input_width_px = read_input_width(path.name, _read_metadata(path))
    return network


def load_centertrack(path: Path) -> DLA34:
    """Converted CenterTrack weights, or what was fine-tuned from them, in evaluation mode.

    Raises:
        InvalidWeights: naming the first thing that does not fit.
    """
    _check_metadata(path, centertrack_metadata())
    return _loaded(DLA34(), path)


def load_monocular(path: Path) -> Monocular:
    """A network in evaluation mode, of the family that the file names.

    Raises:
        InvalidWeights: naming the first thing that does not fit.
    """
    if _read_metadata(path).get("family") != _CENTERTRACK_FAMILY:
        return load_network(path)
    return load_centertrack(path)


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


def _loaded(network: _Network, path: Path) -> _Network:
    state = load_file(str(path))
    check_state(path.name, state, network.state_dict(), None)
    network.load_state_dict(state)
    return network.eval()


def _read_metadata(path: Path) -> dict[str, str]:
    try:
        with safetensors.safe_open(str(path), framework="pt") as file:
            return file.metadata() or {}
    except FileNotFoundError as error:
        raise InvalidWeights(f"{path} does not exist") from error
    except (safetensors.SafetensorError, OSError) as error:
        raise InvalidWeights(f"{path.name} is not a safetensors file: {error}", hint=_NOT_SAFETENSORS_HINT) from error


def _check_metadata(path: Path, expected: Mapping[str, str]) -> None:
    found = _read_metadata(path)
    for key, value in expected.items():
        if found.get(key) != value:
            raise InvalidWeights(f"{path.name}: {key} is {found.get(key)!r}, not {value!r}", field=key)


def bundled(name: str) -> Path:
    """A file that ships with the package: ``mono_small.safetensors`` or ``detector2d.onnx``.

    Raises:
        InvalidWeights: where there is no such file.
    """
    path = Path(str(resources.files("wibam_core.models") / "bundled" / name))
    if not path.is_file():
        raise InvalidWeights(f"no weights named {name} ship with this package")
    return path
