"""What a video clip of a job's results is to show."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from wibam_core.documents.base import Document
from wibam_core.road_users import RoadUserClass

_Metres = Annotated[float, Field(ge=-1e9, le=1e9)]
Corner = tuple[_Metres, _Metres]
_Time = Annotated[int, Field(ge=-(2**62), le=2**62)]
_LONGEST_NS = 1_800_000_000_000


class ClipSpec(Document):
    """A stretch of time, which road users are drawn in it, and how: whom the filter leaves out is not drawn."""

    model_config = ConfigDict(extra="forbid", defer_build=False)

    start_ns: _Time
    """Reference clock; counts in."""
    end_ns: _Time
    """Reference clock; does not count in. At most half an hour after the start."""
    classes: tuple[RoadUserClass, ...] = Field((), max_length=100)
    """None: all."""
    min_speed_mps: float | None = Field(None, ge=0, le=1000)
    polygon: tuple[Corner, ...] = Field((), max_length=100)
    """Corners of an area in m, in order: three or more, or none."""
    colour: Literal["class", "speed", "track"] = "class"
    """What the colours say."""
    trail_s: float = Field(3.0, ge=0, le=60)
    """How far back the plan shows where each road user came from."""
    boxes: bool = True
    """Draw boxes into the cameras' views."""
    speed: float = Field(1.0, ge=0.1, le=10)
    """Of the clip: 2 is twice as fast as it happened."""
    width_px: int = Field(1600, ge=640, le=3840)

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if not 0 < self.end_ns - self.start_ns <= _LONGEST_NS:
            raise ValueError("end_ns must lie after start_ns, by half an hour at most")
        if self.polygon and len(self.polygon) < 3:
            raise ValueError("a polygon has at least three corners")
        return self


class ClipFacts(Document):
    """What a finished clip holds."""

    frames: int
    first_ns: int
    """Instant of the first frame, reference clock."""
    last_ns: int
    width_px: int
    height_px: int
    road_users: int
    """That are drawn in it."""
