"""A user's CenterTrack or WIBAM checkpoint to a safetensors file of our DLA-34.

Checkpoints are pickles, which can run anything when they are read. They are read once, here, by PyTorch's reader that
knows tensors and plain containers alone; all else is refused.
"""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError

import torch
from torch import Tensor

from wibam_core.errors import InvalidWeights
from wibam_core.formats.model_card import metadata_of
from wibam_core.models.weights import check_state, save_state
from wibam_core.networks.dla34.architecture import DLA34, HEADS
from wibam_core.networks.dla34.network import CARD

#: For people who convert such weights or use them.
LICENCE_NOTE = (
    "Weights derived from nuScenes: non-commercial use only, under its terms (https://www.nuscenes.org/terms-of-use)."
)

#: Heads that some checkpoints of the same network have and nothing here reads.
EXTRA_HEADS = ("velocity", "nuscenes_att")

#: What training wrappers put before each name.
_PREFIXES = ("model.", "module.")

_HINT = f"Give a checkpoint of CenterTrack's 3D detection on nuScenes with DLA-34, with the heads {', '.join(HEADS)}."
_CODE_HINT = (
    "Where you trust the file, load it with what wrote it, and save "
    "torch.save({'state_dict': checkpoint['state_dict']}, 'plain.pth'): tensors alone."
)


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Weights that fit our DLA-34.

    Attributes:
        state: name -> tensor, as the network names them.
        prefix: what stood before the names, or "".
        dropped: those of `EXTRA_HEADS` that were there.
        sha256: of the file.
    """

    state: Mapping[str, Tensor]
    prefix: str
    dropped: tuple[str, ...]
    sha256: str


def convert_checkpoint(source: Path, target: Path) -> Checkpoint:
    """Read ``source`` and write ``target``, whole or not at all; the same source always gives the same bytes.

    Raises:
        InvalidWeights: naming the first thing that does not fit.
    """
    if target.suffix != ".safetensors":
        raise InvalidWeights(
            f"the output {target.name} does not end in .safetensors", hint="Name it so: that is what it is."
        )
    found = read_checkpoint(source)
    card = CARD.model_copy(update={"source_name": source.name, "source_sha256": found.sha256, "licence": LICENCE_NOTE})
    target.parent.mkdir(parents=True, exist_ok=True)
    save_state(found.state, target, metadata_of(card))
    return found


def read_checkpoint(path: Path) -> Checkpoint:
    """The weights of a file that `torch.save` wrote: a dict with a ``state_dict``, as CenterTrack and Lightning do.

    Raises:
        InvalidWeights: naming the first thing that does not fit.
    """
    raw = _read_tensors(path)
    expected = DLA34().state_dict()
    state: dict[str, Tensor] = {}
    dropped: set[str] = set()
    prefixes: set[str] = set()
    for key, value in raw.items():
        name, prefix = _without_prefix(key)
        prefixes.add(prefix)
        if name.split(".")[0] in EXTRA_HEADS:
            dropped.add(name.split(".")[0])
            continue
        if name in state:
            raise InvalidWeights(f"{path.name} has the tensor {name} twice", hint=_HINT, tensor=name)
        own = expected.get(name)
        if own is not None and value.shape == own.shape:
            dtype = own.dtype if own.is_floating_point() and value.is_floating_point() else value.dtype
            value = value.to(dtype, copy=True, memory_format=torch.contiguous_format)
        state[name] = value
    check_state(path.name, state, expected, _HINT)
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return Checkpoint(state, max(prefixes), tuple(sorted(dropped)), sha256)


def _read_tensors(path: Path) -> dict[str, Tensor]:
    try:
        with warnings.catch_warnings(action="ignore"):
            content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise InvalidWeights(f"{path} does not exist", hint=_HINT) from error
    except Exception as error:  # damaged pickles end in whatever their bytes happen to mean
        needed = re.search(r"GLOBAL ([\w.]+)", str(error)) if isinstance(error, UnpicklingError) else None
        if needed is None:
            raise InvalidWeights(f"{path.name} is not a checkpoint that PyTorch can read", hint=_HINT) from error
        raise InvalidWeights(
            f"{path.name} needs code to be read ({needed[1]}), which is never run", hint=_CODE_HINT, needs=needed[1]
        ) from error
    state = content.get("state_dict") if isinstance(content, dict) else None
    if not isinstance(state, dict) or not state:
        raise InvalidWeights(f"{path.name} is not a checkpoint: it has no state_dict", hint=_HINT)
    for name, value in state.items():
        if not isinstance(name, str) or not _is_plain(value):
            raise InvalidWeights(f"{path.name}: {name} in its state_dict is not a plain tensor", hint=_HINT)
    return {name: value.detach() for name, value in state.items()}


def _is_plain(value: object) -> bool:
    return isinstance(value, Tensor) and value.layout == torch.strided and not value.is_meta


def _without_prefix(key: str) -> tuple[str, str]:
    name = key
    while name.startswith(_PREFIXES):
        name = name.split(".", 1)[1]
    return name, key.removesuffix(name)
