"""A job's tracks for those who draw them: what there is, states in little space, and where road users went."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query, Response

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
    responses=documented(401, 404, 409, 422),
    dependencies=[ONLY_KNOWN_PARAMETERS],
)


@router.get("/summary", summary="How many tracks there are, when and where")
def summary(job_id: str, services: ServicesDep, asked: AskedTracks, response: Response) -> TracksSummary:
    """Of the states that `GET /v1/jobs/{job_id}/tracks` lists for the same question. The header `ETag` has the SHA-256
    of the tracks: a restart may make others."""
    return track_views.summary(_tracks(services, job_id, response), asked)


@router.get("/compact", summary="7DoF tracks in little space")
def compact(
    job_id: str,
    services: ServicesDep,
    asked: AskedTracks,
    response: Response,
    limit: Annotated[int, Query(ge=1, le=100_000, description="of states")] = 20_000,
    cursor: Annotated[str | None, Query(description="`next` of the page before")] = None,
) -> CompactTracks:
    """The same states by track and rounded, for drawing. Give a start and an end to see a stretch of a long job.
    The header `ETag` has the SHA-256 of the tracks."""
    after = parse_cursor(cursor) if cursor is not None else None
    path = _tracks(services, job_id, response)
    return track_views.compact(path, replace(asked, after=after, limit=limit))


@router.get("/paths", summary="Where road users went")
def paths(job_id: str, services: ServicesDep, asked: AskedTracks, response: Response) -> TrackPaths:
    """Lines from above through the same states, thinned so that those of a long job can be drawn together. The header
    `ETag` has the SHA-256 of the tracks."""
    return track_views.paths(_tracks(services, job_id, response), asked)


def _tracks(services: Services, job_id: str, response: Response) -> Path:
    """The job's tracks; the answer is marked as theirs."""
    file = services.results.file(services.jobs.job(job_id), catalogue.TRACKS)
    response.headers["ETag"] = f'"{file.sha256}"'
    return file.path
