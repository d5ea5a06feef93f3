"""What all documents share."""

from __future__ import annotations

import math

from pydantic import BaseModel, ConfigDict


class Document(BaseModel):
    """A frozen JSON document. A field that a newer version added is passed over; NaN and infinity are refused."""

    model_config = ConfigDict(
        extra="ignore",
        frozen=True,
        allow_inf_nan=False,
        populate_by_name=True,
        use_attribute_docstrings=True,
        defer_build=True,  # most processes use few of the documents
    )


class MeanSd(Document):
    """Mean and standard deviation; null where there was nothing, or one thing, to average."""

    mean: float | None = None
    sd: float | None = None


class Histogram(Document):
    """Counts between edges, which are one more than the counts."""

    edges: list[float]
    counts: list[int]


def finite(value: float) -> float | None:
    """A number as documents hold it: NaN and infinity are null."""
    return float(value) if math.isfinite(value) else None
