"""A model card as a file of weights carries it: safetensors and ONNX files hold strings by key, and nothing else.

What the file says of its tensors is `wibam_core.models.weights`' business; nothing here reads any.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import get_args

import safetensors

from wibam_core.documents.model_card import ModelCard, SdKind
from wibam_core.errors import InvalidWeights
from wibam_core.placing import Decode

#: Widths of images that a card may name, px, as the option ``finetune.input_width_px`` has them.
INPUT_WIDTHS_PX = range(320, 1920 + 1, 32)

_NOT_SAFETENSORS_HINT = (
    "Give a safetensors file made for this network. `wibam weights convert` makes one of CenterTrack's .pth or WIBAM's "
    ".ckpt."
)

#: Fields that a file says as they are.
_PLAIN = ("family", "version", "decode", "start", "method", "device", "source_name", "source_sha256", "licence")


def metadata_of(card: ModelCard) -> dict[str, str]:
    """What a file says, by key; what the card does not know is left out.

    Keys are named as the card's fields. ``classes`` are parted by commas, ``sd_factors`` are a JSON object.
    """
    said = {key: str(value) for key in _PLAIN if (value := getattr(card, key)) is not None}
    said["classes"] = ",".join(card.classes)
    if card.input_width_px is not None:
        said["input_width_px"] = str(card.input_width_px)
    if card.sd_factors:
        said["sd_factors"] = json.dumps(card.sd_factors, allow_nan=False)
    return said


def read_metadata(path: Path) -> dict[str, str]:
    """What a safetensors file says, by key.

    Raises:
        InvalidWeights: it does not exist, or is no such file.
    """
    try:
        with safetensors.safe_open(str(path), framework="np") as file:
            return file.metadata() or {}
    except FileNotFoundError as error:
        raise InvalidWeights(f"{path} does not exist") from error
    except (safetensors.SafetensorError, OSError) as error:
        raise InvalidWeights(f"{path.name} is not a safetensors file: {error}", hint=_NOT_SAFETENSORS_HINT) from error


def card_of(source: str, metadata: Mapping[str, str], decodes: Sequence[Decode] = get_args(Decode)) -> ModelCard:
    """The card that a file carries.

    Args:
        source: name of the file.
        metadata: what it says, by key; keys that no card has are passed over.
        decodes: how boxes of its family can be placed; first what a file means that does not say.

    Raises:
        InvalidWeights: it says what cannot be.
    """
    said = {key: metadata[key] for key in _PLAIN if key in metadata}
    decode = next((known for known in decodes if known == said.get("decode", decodes[0])), None)
    if decode is None:
        raise InvalidWeights(f"{source}: decode is {said['decode']!r}, not one of {', '.join(decodes)}", field="decode")
    for key in ("start", "device"):
        known = get_args(get_args(ModelCard.model_fields[key].annotation)[0])
        if said.get(key, known[0]) not in known:
            raise InvalidWeights(f"{source}: {key} is {said[key]!r}, not one of {', '.join(known)}", field=key)
    return ModelCard.model_validate(
        {
            **said,
            "decode": decode,
            "classes": tuple(metadata.get("classes", "").split(",")),
            "input_width_px": _input_width_px(source, metadata.get("input_width_px")),
            "sd_factors": _sd_factors(source, metadata.get("sd_factors", "{}")),
        }
    )


def read_card(path: Path) -> ModelCard:
    """The card of a safetensors file, whatever its family.

    Raises:
        InvalidWeights: it does not exist, is no such file, or says what cannot be.
    """
    return card_of(path.name, read_metadata(path))


def _input_width_px(source: str, said: str | None) -> int | None:
    if said is None:
        return None
    width = int(said) if re.fullmatch("[0-9]{1,5}", said) else 0
    if width not in INPUT_WIDTHS_PX:
        raise InvalidWeights(
            f"{source}: input_width_px is {said!r}, not a multiple of {INPUT_WIDTHS_PX.step} from {INPUT_WIDTHS_PX[0]} "
            f"to {INPUT_WIDTHS_PX[-1]}",
            field="input_width_px",
        )
    return width


def _sd_factors(source: str, said: str) -> dict[str, float]:
    try:
        factors = json.loads(said)
        well = all(math.isfinite(value) and value > 0 for value in factors.values())
    except (ValueError, TypeError, AttributeError, OverflowError):
        well = False
    if not well:
        raise InvalidWeights(
            f"{source}: sd_factors is {said!r}, not a JSON object of positive numbers", field="sd_factors"
        )
    unknown = sorted(set(factors) - set(get_args(SdKind)))
    if unknown:
        raise InvalidWeights(
            f"{source}: sd_factors names {', '.join(unknown)}, but there are only {', '.join(get_args(SdKind))}",
            field="sd_factors",
        )
    return factors
