"""What is known of a network that a service keeps: where it comes from, what it learned from, and how good it is."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from wibam_core.documents.base import Document
from wibam_core.documents.metrics import Consistency, DetectorFigures
from wibam_core.documents.model_card import ModelCard


class Parent(Document):
    """What a network was fine-tuned from."""

    name: str
    """"bundled", or the name of the file that was given."""
    sha256: str | None = None
    """Of the file; null for the bundled network."""
    model_id: str | None = None
    """The same network, where this service keeps it, too."""


class Training(Document):
    """What a network learned from, and how."""

    options: dict[str, Any]
    """Of fine-tuning, by name."""
    instants: dict[str, int]
    """Instants in the parts "train", "val" and "test"."""
    frames: int
    """Pictures that it learned from."""
    vehicles: int | None = None
    """Different road users that it learned from."""
    kept_step: int | None = None
    """The step whose weights were kept."""


class ModelMetrics(Document):
    """How good it was on the test part of its own job. Every figure is a mean with its standard deviation."""

    labels: str
    """"hand" or "none"."""
    finetuned: DetectorFigures | None = None
    """Against hand labels; null where there were none."""
    baseline: DetectorFigures | None = None
    """The network that it was fine-tuned from, on the same."""
    self_consistency: dict[str, Consistency] = Field(default_factory=dict)
    """Agreement with the views that boxes were not made in, of "baseline" and "finetuned"."""


class ModelDocument(Document):
    """A network's card, as the service keeps it."""

    card: ModelCard
    """What its file says: family, classes, how boxes are placed, licence."""
    site_name: str | None = None
    cameras: list[str] = Field(default_factory=list)
    """Those whose pictures it learned from."""
    parent: Parent | None = None
    training: Training | None = None
    """Null for a network that was uploaded."""
    metrics: ModelMetrics | None = None
