"""What happened during fine-tuning."""

from __future__ import annotations

from typing import Literal

from wibam_core.documents.base import Document


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

    kept: Literal["best", "last"]
    kept_step: int
    epochs: list[Epoch]
