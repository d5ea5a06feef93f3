"""A job's tracks for those who draw them: what there is, states in little space, and where road users went."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Header, Query, Response

from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.services import Services, ServicesDep
from api.track_parameters import AskedTracks
from wibam_core.adapters import track_views
from wibam_core.adapters.track_query import parse_cursor
from wibam_core.artifacts import catalogue
from wibam_core.documents.tracks import CompactTracks, TrackPaths, TracksSummary

router = APIRouter(
    prefix="/v1/jobs/{job_id}/tracks",
    tags=["results"],
    responses={304: {"description": "Not Modified"}, **documented(401, 404, 409, 422)},
    dependencies=[ONLY_KNOWN_PARAMETERS],
)


#: What a client keeps: its `ETag`, or several, or `*`.
Kept = Annotated[str | None, Header(alias="If-None-Match")]


@router.get("/summary", response_model=TracksSummary, summary="How many tracks there are, when and where")
def summary(
    job_id: str, services: ServicesDep, asked: AskedTracks, response: Response, kept: Kept = None
) -> TracksSummary | Response:
    """Of the states that `GET /v1/jobs/{job_id}/tracks` lists for the same question. The header `ETag` has the SHA-256
    of the tracks: a restart may make others. Who sends it as `If-None-Match` is told whether it still holds."""
    path = _tracks(services, job_id, response, kept)
    return path if isinstance(path, Response) else track_views.summary(path, asked)


@router.get("/compact", response_model=CompactTracks, summary="7DoF tracks in little space")
def compact(
    job_id: str,
    services: ServicesDep,
    asked: AskedTracks,
    response: Response,
    limit: Annotated[int, Query(ge=1, le=100_000, description="of states")] = 20_000,
    cursor: Annotated[str | None, Query(description="`next` of the page before")] = None,
    kept: Kept = None,
) -> CompactTracks | Response:
    """The same states by track and rounded, for drawing. Give a start and an end to see a stretch of a long job.
    The header `ETag` has the SHA-256 of the tracks."""
    after = parse_cursor(cursor) if cursor is not None else None
    path = _tracks(services, job_id, response, kept)
    return path if isinstance(path, Response) else track_views.compact(path, replace(asked, after=after, limit=limit))


@router.get("/paths", response_model=TrackPaths, summary="Where road users went")
def paths(
    job_id: str, services: ServicesDep, asked: AskedTracks, response: Response, kept: Kept = None
) -> TrackPaths | Response:
    """Lines from above through the same states, thinned so that those of a long job can be drawn together. The header
    `ETag` has the SHA-256 of the tracks."""
    path = _tracks(services, job_id, response, kept)
    return path if isinstance(path, Response) else track_views.paths(path, asked)


def _tracks(services: Services, job_id: str, response: Response, kept: str | None) -> Path | Response:
    """The job's tracks, with which the answer is marked; where a client keeps them already, that answer."""
    file = services.results.file(services.jobs.job(job_id), catalogue.TRACKS)
    etag = f'"{file.sha256}"'
    if kept is not None and {"*", etag} & {one.strip().removeprefix("W/") for one in kept.split(",")}:
        return Response(status_code=304, headers={"ETag": etag})
    response.headers["ETag"] = etag
    return file.path
