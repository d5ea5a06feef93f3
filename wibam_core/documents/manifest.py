"""What the store knows about a published stage."""

from __future__ import annotations

from pydantic import AliasChoices, Field, JsonValue

from wibam_core.documents.base import Document
from wibam_core.documents.warnings import StageWarning


class FileFacts(Document):
    """A file of a stage."""

    bytes: int
    sha256: str


class Manifest(Document):
    """A published stage: its address, what it said, and its files."""

    stage: str
    hash: str = Field(validation_alias=AliasChoices("hash", "digest"))
    """The address of its outputs; called digest in what version 0.1 left."""
    frame_hash: str | None = None
    """Outputs of one such hash hold the same of each frame; null for a stage that does not work frame by frame."""
    seconds: float
    """How long it took."""
    summary: dict[str, JsonValue]
    warnings: tuple[StageWarning, ...] = ()
    """In the order in which the stage came upon them."""
    files: dict[str, FileFacts]
    """By name within the stage's folder."""
