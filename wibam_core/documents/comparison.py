"""Two networks on the same held-out instants."""

from __future__ import annotations

from typing import Literal

from wibam_core.documents.base import Document
from wibam_core.documents.metrics import Consistency, DetectorFigures, Significance


class ComparedNetwork(Document):
    """How one of the two did."""

    consistency: Consistency
    figures: DetectorFigures | None = None
    """Against hand labels; null where none of the instants is labelled."""


class NetworkComparison(Document):
    """Two networks on instants that neither learned from; differences are the second's figures less the first's."""

    first: ComparedNetwork
    second: ComparedNetwork
    instants: int
    frames: int
    from_s: float
    """The first of the instants, on the reference clock."""
    to_s: float
    labels: Literal["hand", "none"]
    other_views: Significance
    """Of the IoU in the views that a box was not made in."""
    significance: dict[str, Significance] | None = None
    """Against hand labels, by metric."""
    not_asked_for: list[str]
    """Road users that one of the two does not know: they count nowhere."""
    cautions: list[str]
    """What makes the comparison less than fair, in sentences."""
