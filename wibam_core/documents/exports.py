"""What a job can be exported in."""

from __future__ import annotations

from enum import StrEnum

from pydantic import Field

from wibam_core.documents.base import Document


class BoxSource(StrEnum):
    """Which 3D boxes are exported: the fits to all views of the whole recording, or what the fine-tuned network says of
    single images of the test part."""

    FITS = "fits"
    NETWORK = "network"


class ExportOffer(Document):
    """A format, and whether a job has what it takes."""

    name: str = Field(examples=["geojson"])
    title: str
    loses: str
    """What of a job's results it has no place for."""
    available: bool
    missing: tuple[str, ...]
    """Kinds of content that are needed and not there."""
