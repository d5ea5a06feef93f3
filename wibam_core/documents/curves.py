"""What happened during fine-tuning."""

from __future__ import annotations

from typing import Literal

from wibam_core.config import DeviceOption
from wibam_core.documents.base import Document
from wibam_core.placing import Decode


class Epoch(Document):
    """Mean losses of one epoch, by part of the loss and as "total"."""

    step: int
    """The last step of the epoch."""
    learning_rate: float
    train: dict[str, float]
    validation: dict[str, float]
    """Empty without a validation part."""


class Curves(Document):
    """The losses of a training, and which weights were kept."""

    method: str
    decode: Decode
    """How boxes are placed."""
    network: Literal["small", "custom"]
    """"custom": one of the site's own."""
    input_width_px: int | None = None
    """How wide the small network sees images."""
    device: DeviceOption
    """Where it was asked to train."""
    sd_factors: dict[str, float]
    """Kind of number -> what the network's standard deviations are to be multiplied with."""
    kept: Literal["best", "last"]
    kept_step: int
    epochs: list[Epoch]
