"""Which states of a job's tracks a request asks for."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Query
from pydantic import Field

from wibam_core.adapters.track_query import TrackQuery, parse_bounds, parse_polygon
from wibam_core.road_users import RoadUserClass

Int64 = Annotated[int, Field(ge=-(2**63), le=2**63 - 1)]


def _asked(
    start_ns: Annotated[Int64 | None, Query(description="reference clock; counts in")] = None,
    end_ns: Annotated[Int64 | None, Query(description="reference clock; does not count in")] = None,
    bounds: Annotated[
        str | None, Query(description="`x_min,y_min,x_max,y_max` in m", examples=["-10,-10,10,10"])
    ] = None,
    polygon: Annotated[str | None, Query(description="corners `x1,y1;x2,y2;...` in m", max_length=4000)] = None,
    vehicle_class: Annotated[
        list[RoadUserClass] | None, Query(alias="class", description="any of these", max_length=100)
    ] = None,
    track_id: Annotated[list[Int64] | None, Query(description="any of these", max_length=1000)] = None,
    min_speed_mps: Annotated[float | None, Query(ge=0, allow_inf_nan=False)] = None,
) -> TrackQuery:
    return TrackQuery(
        start_ns=start_ns,
        end_ns=end_ns,
        bounds=parse_bounds(bounds) if bounds is not None else None,
        polygon=parse_polygon(polygon) if polygon is not None else (),
        classes=tuple(vehicle_class or ()),
        track_ids=tuple(track_id or ()),
        min_speed_mps=min_speed_mps,
    )


#: Of a route's parameters: all that restrict, without where to go on and how many.
AskedTracks = Annotated[TrackQuery, Depends(_asked)]
