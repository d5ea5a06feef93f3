"""What is known about a 3D network; its weights file says it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, PositiveFloat

from wibam_core.config import DeviceOption
from wibam_core.documents.base import Document
from wibam_core.placing import Decode

#: Kinds of numbers of a box whose standard deviations have a factor each. Z is apart: on the ground plane it errs as
#: the height does.
SdKind = Literal["position", "z", "size", "yaw"]


class ModelCard(Document):
    """A 3D network's card."""

    family: str
    """Which kind of network: a name of `wibam_core.networks.registry`."""
    version: str = "1"
    """Of the family's tensors."""
    classes: tuple[str, ...]
    """What the channels of its heat map find, in their order."""
    decode: Decode
    """How its boxes are to be placed."""
    input_width_px: int | None = None
    """How wide it sees images; null: as its family does."""
    sd_factors: dict[SdKind, PositiveFloat] = Field(default_factory=dict)
    """What its standard deviations are to be multiplied with; 1 for what is not named."""
    start: Literal["small", "custom"] | None = None
    """What it was fine-tuned from, as the option ``finetune.network``; null: it was not."""
    method: str | None = None
    """How it was fine-tuned, as the option ``finetune.method``."""
    device: DeviceOption | None = None
    """Where it was asked to be fine-tuned, as the option ``finetune.device``."""
    source_name: str | None = None
    """The file that its weights were converted from."""
    source_sha256: str | None = None
    """SHA-256 of that file."""
    licence: str | None = None
    """Under which terms the weights may be used; those of what it was fine-tuned from hold on."""
