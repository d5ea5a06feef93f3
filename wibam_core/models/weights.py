"""Weights as safetensors files, checked against the network before anything is loaded."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import safetensors
from safetensors.torch import load_file, save_file

from wibam_core.errors import InvalidWeights
from wibam_core.models.small import SmallNetwork
from wibam_core.scene import CLASSES

_FAMILY = "wibam-small"
_VERSION = "1"


def metadata() -> dict[str, str]:
    """What a weights file says about itself."""
    return {"family": _FAMILY, "version": _VERSION, "classes": ",".join(CLASSES)}


def save_network(network: SmallNetwork, path: Path) -> None:
    """Write ``network`` to a safetensors file, whole or not at all."""
    temporary = path.with_name(path.name + ".tmp")
    state = {name: value.detach().cpu().contiguous() for name, value in network.state_dict().items()}
    save_file(state, str(temporary), metadata=metadata())
    temporary.replace(path)


def load_network(path: Path) -> SmallNetwork:
    """A network in evaluation mode.

    Raises:
        InvalidWeights: naming the first thing that does not fit.
    """
    _check_metadata(path)
    network = SmallNetwork()
    state = load_file(str(path))
    expected = network.state_dict()
    for name, value in expected.items():
        if name not in state:
            raise InvalidWeights(f"{path.name} lacks the tensor {name}", tensor=name)
        if state[name].shape != value.shape:
            raise InvalidWeights(
                f"{path.name}: tensor {name} has shape {tuple(state[name].shape)}, not {tuple(value.shape)}",
                tensor=name,
            )
        if state[name].dtype != value.dtype:
            raise InvalidWeights(f"{path.name}: tensor {name} is {state[name].dtype}, not {value.dtype}", tensor=name)
        if not bool(state[name].isfinite().all()):
            raise InvalidWeights(f"{path.name}: tensor {name} has values that are not finite", tensor=name)
    for name in state:
        if name not in expected:
            raise InvalidWeights(f"{path.name} has a tensor {name} that the network lacks", tensor=name)
    network.load_state_dict(state)
    return network.eval()


def _check_metadata(path: Path) -> None:
    try:
        with safetensors.safe_open(str(path), framework="pt") as file:
            found = file.metadata() or {}
    except FileNotFoundError as error:
        raise InvalidWeights(f"{path} does not exist") from error
    except (safetensors.SafetensorError, OSError) as error:
        raise InvalidWeights(f"{path.name} is not a safetensors file: {error}") from error
    for key, value in metadata().items():
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
