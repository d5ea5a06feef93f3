"""Which 3D networks there are, and how their files are read and written.

A network is a package with a `Family` called ``FAMILY``, and a line in `FAMILIES`.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

import torch

from wibam_core.config import FinetuneConfig
from wibam_core.documents.model_card import ModelCard
from wibam_core.errors import InvalidWeights
from wibam_core.formats.model_card import card_of, metadata_of, read_metadata
from wibam_core.models.network import Network
from wibam_core.models.onnx_session import open_session
from wibam_core.models.weights import save_state
from wibam_core.networks.family import Family
from wibam_core.training.device import choose_device_to_detect
from wibam_core.training.trainable import TrainableNetwork

#: Name of a family in weights files -> its package.
FAMILIES: dict[str, str] = {
    "wibam-small": "wibam_core.networks.small",
    "centertrack-dla34": "wibam_core.networks.dla34",
}

_HINT = (
    "Give a fine-tuned model, as safetensors or ONNX, or what `wibam weights convert` makes of CenterTrack's .pth or "
    "WIBAM's .ckpt."
)


def family_of(name: str) -> Family:
    """The family of this name."""
    family: Family = import_module(FAMILIES[name]).FAMILY
    return family


def _family_said(source: str, metadata: Mapping[str, str]) -> Family:
    """The family that a file names."""
    name = metadata.get("family")
    if name not in FAMILIES:
        raise InvalidWeights(
            f"{source}: family is {name!r}, not {' or '.join(map(repr, FAMILIES))}", hint=_HINT, field="family"
        )
    return family_of(name)


def read_card(path: Path) -> ModelCard:
    """What a weights file says about its network.

    Raises:
        InvalidWeights: it is no such file, or says what cannot be.
    """
    metadata = read_metadata(path)
    return card_of(path.name, metadata, _family_said(path.name, metadata).decodes)


def load_network(path: Path, input_width_px: int | None = None) -> TrainableNetwork:
    """The network of a weights file, on the CPU in evaluation mode.

    Args:
        path: of the file.
        input_width_px: how wide it is to see images; None: as the file says.

    Raises:
        InvalidWeights: naming the first thing that does not fit.
    """
    card = read_card(path)
    if input_width_px is not None:
        card = card.model_copy(update={"input_width_px": input_width_px})
    return family_of(card.family).load(path, card)


def load_to_train(path: Path, config: FinetuneConfig) -> TrainableNetwork:
    """The network of a weights file, to be fine-tuned as the options say.

    Raises:
        InvalidWeights: naming the first thing that does not fit.
        InvalidOption: it has no use for one of the options.
    """
    family_of(read_card(path).family).check(config)
    return load_network(path, config.input_width_px)


def load_to_detect(path: Path, device: torch.device | None = None, input_width_px: int | None = None) -> Network:
    """The network of a weights file or an ONNX file as it detects fastest.

    Args:
        path: of the file.
        device: where it is to run, if it is there that it is fastest; None: where it was trained, or on the CPU where
            there is no such device.
        input_width_px: how wide it is to see images; None: as the file says. ONNX files see what they say.

    Raises:
        InvalidWeights: naming the first thing that does not fit.
    """
    if path.suffix != ".onnx":
        network = load_network(path, input_width_px)
        return network.runnable(device or choose_device_to_detect(network.card.device or "auto"))
    session = open_session(path, path.name, threads=torch.get_num_threads(), hint=_HINT)
    family = _family_said(path.name, session.get_modelmeta().custom_metadata_map)
    if family.load_onnx is None:
        raise InvalidWeights(f"{path.name}: networks of the family {family.name} have no ONNX files", hint=_HINT)
    return family.load_onnx(session, path.name)


def save_network(network: TrainableNetwork, path: Path) -> None:
    """Write a network, on any device, and its card to a safetensors file, whole or not at all.

    The same network gives the same bytes.
    """
    save_state(network.module.state_dict(), path, metadata_of(network.card))
