"""The tracks of all runs and jobs of a site, on one clock: hours, days, months."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query
from pydantic import BaseModel, Field
from starlette.responses import JSONResponse, Response, StreamingResponse

from api.paging import PageDep, Time
from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.services import ServicesDep
from api.streams import STREAMS
from api.times import parse_time, to_time
from wibam_core.adapters.site_tracks import Bin, SitePart, SiteQuery
from wibam_core.adapters.track_query import TrackQuery, parse_bounds, parse_polygon
from wibam_core.documents.tracks import TrackState
from wibam_core.errors import InputError
from wibam_core.road_users import RoadUserClass

router = APIRouter(prefix="/v1/sites/{site_id}/tracks", tags=["models"], responses=documented(401, 404, 422))
_PAGE = 1000


class SiteTrackState(TrackState):
    """A road user at one time, Unix time, and whose footage showed it. `first_run_id` and `track_id` name the user."""

    run_id: str
    first_run_id: str
    camera: str


class SiteTrackPage(BaseModel):
    """States of tracked road users, sorted by time, run and track."""

    states: list[SiteTrackState]
    next: str | None = Field(description="cursor of the next page")


class SitePartOut(BaseModel):
    """What one run, or job, has in its site's table."""

    run_id: str
    first_run_id: str = Field(description="the first of the runs that go on with each other")
    model_id: str | None = Field(description="null: the job's own")
    cameras: list[str]
    start: datetime
    end: datetime
    states: int

    @classmethod
    def of(cls, part: SitePart) -> SitePartOut:
        return cls(
            run_id=part.run_id,
            first_run_id=part.first_run_id,
            model_id=part.model_id,
            cameras=list(part.cameras),
            start=to_time(part.start_ns),
            end=to_time(part.end_ns),
            states=part.states,
        )


class CountOut(BaseModel):
    """Road users of one class in one hour, day or month."""

    start: datetime = Field(description="of the hour, day or month, UTC")
    road_user_class: str = Field(serialization_alias="class")
    road_users: int
    mean_speed_mps: float = Field(description="over all their states")


def _query(
    start: Annotated[Time, Query(alias="from", description="ISO 8601 with its offset from UTC; counts in")] = None,
    end: Annotated[Time, Query(alias="to", description="does not count in")] = None,
    bounds: Annotated[
        str | None, Query(description="`x_min,y_min,x_max,y_max` in m", examples=["-10,-10,10,10"], max_length=400)
    ] = None,
    polygon: Annotated[str | None, Query(description="corners `x1,y1;x2,y2;...` in m", max_length=4000)] = None,
    vehicle_class: Annotated[
        list[RoadUserClass] | None, Query(alias="class", description="any of these", max_length=100)
    ] = None,
    min_speed_mps: Annotated[float | None, Query(ge=0, allow_inf_nan=False)] = None,
    camera: Annotated[
        list[str] | None, Query(description="footage of any of these, alone or with others", max_length=100)
    ] = None,
    run: Annotated[list[str] | None, Query(description="of any of these runs or jobs", max_length=1000)] = None,
    model: Annotated[list[str] | None, Query(description="found by any of these models", max_length=100)] = None,
) -> SiteQuery:
    states = TrackQuery(
        start_ns=parse_time(start) if start is not None else None,
        end_ns=parse_time(end) if end is not None else None,
        bounds=parse_bounds(bounds) if bounds is not None else None,
        polygon=parse_polygon(polygon) if polygon is not None else (),
        classes=tuple(vehicle_class or ()),
        min_speed_mps=min_speed_mps,
    )
    return SiteQuery(states, tuple(camera or ()), tuple(run or ()), tuple(model or ()))


Asked = Annotated[SiteQuery, Depends(_query)]


@router.get(
    "",
    summary="Tracks of all runs of a site",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses={
        200: {
            "model": SiteTrackPage,
            "content": {"text/csv": {}, "application/vnd.apache.parquet": {}},
            "description": "JSON in pages; CSV and Parquet whole, unless a limit is given",
        }
    },
)
def tracks(
    site_id: str,
    services: ServicesDep,
    query: Asked,
    format: Literal["json", "csv", "parquet"] = "json",
    limit: Annotated[int | None, Query(ge=1, le=100_000)] = None,
    cursor: Annotated[str | None, Query(description="`next` of the page before", max_length=200)] = None,
) -> Response:
    """Those of all runs, and of jobs, of which it is known when the footage began (`started_at` of its files)."""
    _there(services, site_id)
    page = limit if limit is not None else _PAGE if format == "json" else None
    states = TrackQuery(**{**vars(query.states), "limit": page})
    after = _parse_cursor(cursor) if cursor is not None else None
    asked = SiteQuery(states, query.cameras, query.runs, query.models, after)
    if format == "json":
        with services.site_tracks.query(site_id, asked) as batches:
            found = [state for batch in batches for state in batch.to_pylist()]
        last = found[-1] if len(found) == page else None
        following = f"{last['time_ns']}_{last['track_id']}_{last['run_id']}" if last else None
        return JSONResponse({"states": found, "next": following})
    opened = services.site_tracks.query(site_id, asked)
    headers = {"Content-Disposition": f'attachment; filename="{site_id}-tracks.{format}"'}
    stream, media_type = STREAMS[format]
    return StreamingResponse(stream(opened), media_type=media_type, headers=headers)


@router.get("/parts", summary="What a site's table of tracks holds", dependencies=[ONLY_KNOWN_PARAMETERS])
def parts(site_id: str, services: ServicesDep, page: PageDep) -> list[SitePartOut]:
    """The runs and jobs, by time."""
    _there(services, site_id)
    found = [part for part in services.site_tracks.parts(site_id) if part.states]
    return [SitePartOut.of(part) for part in page.of_all(found, lambda part: (part.start_ns, part.run_id), int, str)]


@router.get("/counts", summary="Road users by hour, day or month", dependencies=[ONLY_KNOWN_PARAMETERS])
def counts(
    site_id: str,
    services: ServicesDep,
    query: Asked,
    page: PageDep,
    by: Annotated[Bin, Query(description="UTC")] = "hour",
) -> list[CountOut]:
    """How many road users of each class were seen, and how fast they were; with the same filters as the tracks."""
    _there(services, site_id)
    found = services.site_tracks.counts(site_id, query, by)
    counted = page.of_all(found, lambda one: (one.start.timestamp(), one.road_user_class), float, str)
    return [CountOut(**vars(count)) for count in counted]


def _there(services: ServicesDep, site_id: str) -> None:
    """What has ended until now is in the table. Raises:
    NotFound: there is no such site.
    """
    services.sites.site(site_id)
    services.site_tracks.take_in_all()


def _parse_cursor(text: str) -> tuple[int, str, int]:
    found = re.fullmatch(r"(-?\d{1,19})_(-?\d{1,19})_(\w{1,64})", text, re.ASCII)
    if not found:
        raise InputError(f"{text!r} is no cursor", hint="Use the value of 'next' from the page before.")
    return int(found[1]), found[3], int(found[2])
