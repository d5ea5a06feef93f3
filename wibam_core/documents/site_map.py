"""A picture of a site from above, and where it lies in the site's world."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from wibam_core.documents.base import Document
from wibam_core.site import Origin

Row = Annotated[tuple[float, float, float], Field(description="a, b, c of a u + b v + c")]
Placing = tuple[Row, Row]
PlacedBy = Literal["nothing", "points", "world file", "GeoTIFF"]


class SiteMap(Document):
    """An aerial picture or a plan, as the service keeps it."""

    filename: str
    """As whoever sent it called it."""
    width_px: int
    """Of the picture that is kept; a large one is kept smaller."""
    height_px: int
    sent_width_px: int
    """Of the picture as it was sent."""
    sent_height_px: int
    placing: Placing | None
    """(2, 3): pixel (u, v), whose (0, 0) is the centre of the top-left one, to world X and Y in m; null while nobody
    has said where it lies."""
    placed_by: PlacedBy
    """What tells the placing."""
    origin: Origin | None = None
    """Of the site, as it was when a GeoTIFF was laid on Earth by it; null where the placing needs none."""
