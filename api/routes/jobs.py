"""Jobs: create, look at, cancel, restart, delete, follow."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.sse import EventSourceResponse, ServerSentEvent
from starlette.concurrency import run_in_threadpool

from api import job_lists
from api.addresses import address
from api.bodies import BoundedJsonRoute
from api.job_lists import JobFilterDep
from api.paging import PageDep
from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.schemas import (
    EventOut,
    JobChangeIn,
    JobIn,
    JobOut,
    LogOut,
    PlannedStageOut,
    RestartIn,
    ShareLinkIn,
    ShareLinkOut,
)
from api.services import Services, ServicesDep
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.logs import read_log
from wibam_core.adapters.planning import made_anew, plan_stages
from wibam_core.job_kind import JobKind
from wibam_core.jobs.records import Job
from wibam_core.stages.graph import PlannedStage, downstream

router = APIRouter(prefix="/v1", tags=["jobs"], responses=documented(401), route_class=BoundedJsonRoute)
_LOOK_EVERY_S = 0.4


@router.post("/sites/{site_id}/jobs", status_code=201, summary="Create a job", responses=documented(404, 409, 413, 422))
def create(
    site_id: str,
    body: JobIn,
    services: ServicesDep,
    request: Request,
    response: Response,
    idempotency_key: Annotated[
        str | None,
        Header(max_length=255, description="a second request with the same key gets the job that the first one made"),
    ] = None,
) -> JobOut:
    """Works on the site and its files as they are now; later changes of the site do not touch the job, nor its
    restarts.

    Every camera needs a recording (`missing_camera` otherwise), every option must exist (`unknown_option`) and have a
    value that it takes (`invalid_option`).
    """
    site = services.sites.site(site_id)
    files = services.sites.files(site_id)
    plan = plan_stages(site.site, body.options, files)
    job, ready = services.jobs.create(site, body.options, files, plan, idempotency_key, body.name, tags=body.tags)
    response.headers["Location"] = address(request, f"/v1/jobs/{job.id}")
    return _begun(services, job, ready)


@router.post("/sites/{site_id}/plan", summary="What would a job do?", responses=documented(404, 422))
def plan(site_id: str, body: JobIn, services: ServicesDep) -> list[PlannedStageOut]:
    """Which stages would run, and which would reuse outputs that are there. Nothing is started."""
    site = services.sites.site(site_id)
    return _planned(services, plan_stages(site.site, body.options, services.sites.files(site_id)))


@router.get("/jobs", summary="List jobs", dependencies=[ONLY_KNOWN_PARAMETERS], responses=documented(422))
def list_jobs(
    services: ServicesDep,
    page: PageDep,
    wanted: JobFilterDep,
    kind: Annotated[JobKind, Query(description="`run`: of networks on new footage")] = JobKind.TRAINING,
) -> list[JobOut]:
    """The newest first."""
    return job_lists.list_jobs(services, page, wanted, kind)


@router.get("/jobs/{job_id}", summary="Look at a job", responses=documented(404))
def get(job_id: str, services: ServicesDep) -> JobOut:
    return _out(services.jobs.job(job_id))


@router.patch("/jobs/{job_id}", summary="Rename or tag a job", responses=documented(404, 422))
def change(job_id: str, body: JobChangeIn, services: ServicesDep) -> JobOut:
    """What is left out stays; tags take the place of those that the job has."""
    return _out(services.jobs.change(job_id, name=body.name, tags=body.tags))


@router.post("/jobs/{job_id}/share-link", summary="Share a job", responses=documented(404, 422))
def share_link(job_id: str, body: ShareLinkIn, services: ServicesDep) -> ShareLinkOut:
    """A link to the job's pages that works for a limited time, for reading alone."""
    services.jobs.job(job_id)
    key = services.passes.share(job_id, body.lifetime_h * 3600.0)
    expires_at = datetime.fromtimestamp(time.time() + services.passes.remaining_s(key), UTC)
    return ShareLinkOut(url=f"/share/{job_id}?key={key}", expires_at=expires_at)


@router.post("/jobs/{job_id}/cancel", status_code=202, summary="Cancel a job", responses=documented(404))
def cancel(job_id: str, services: ServicesDep) -> JobOut:
    """A running stage is stopped within seconds. A job that has ended stays as it is."""
    return _out(services.jobs.cancel(job_id))


@router.post("/jobs/{job_id}/restart", status_code=202, summary="Restart a job", responses=documented(404, 409, 422))
def restart(job_id: str, body: RestartIn, services: ServicesDep) -> JobOut:
    """Runs the stages that have no outputs, those whose options changed, and, with `from_stage`, that stage and all
    that follow from it. Where there are none, it succeeds again at once. The job keeps its files and its id.
    `POST /v1/jobs/{id}/plan` says beforehand which stages would run.
    """
    options, plan = _restart_plan(services, job_id, body)
    job, ready = services.jobs.restart(job_id, options, plan, body.from_stage)
    return _begun(services, job, ready)


@router.post("/jobs/{job_id}/plan", summary="What would a restart do?", responses=documented(404, 422))
def restart_plan(job_id: str, body: RestartIn, services: ServicesDep) -> list[PlannedStageOut]:
    """Which stages would run. Nothing is started."""
    _, plan = _restart_plan(services, job_id, body)
    wanted_before = {stage.name: stage.hash for stage in services.jobs.job(job_id).stages if stage.forced}
    anew = made_anew(plan, body.from_stage, wanted_before)
    return [
        stage.model_copy(update={"would": "run"}) if stage.name in anew else stage for stage in _planned(services, plan)
    ]


@router.delete("/jobs/{job_id}", status_code=204, summary="Delete a job", responses=documented(404, 409))
def delete(job_id: str, services: ServicesDep) -> None:
    """Its outputs go with it, except those that another job refers to. A job that has not ended is kept (409)."""
    clips = services.clips.clips(job_id)
    services.jobs.delete(job_id, services.stages.remove)
    services.folder.remove_log(job_id)
    for clip in clips:
        services.folder.clip(clip.id).unlink(missing_ok=True)


@router.get("/jobs/{job_id}/log", summary="Read a job's log", responses=documented(404))
def log(
    job_id: str,
    services: ServicesDep,
    offset: Annotated[int, Query(ge=0, le=2**40, description="in bytes; `next_offset` of the part before")] = 0,
) -> LogOut:
    """What the stages printed, and what the workers did."""
    ended = services.jobs.job(job_id).state.is_terminal
    text, following = read_log(services.folder.log(job_id), offset)
    return LogOut(text=text, next_offset=following, complete=ended and not text)


async def _existing_job(job_id: str, services: ServicesDep) -> str:
    await run_in_threadpool(services.jobs.events, job_id, 0, 1)
    return job_id


@router.get(
    "/jobs/{job_id}/events",
    summary="Follow a job",
    response_class=EventSourceResponse,
    responses={
        200: {"description": "server-sent events `job`, `stage` and `progress`; their data is an EventOut"},
        **documented(404),
    },
)
async def events(
    job_id: Annotated[str, Depends(_existing_job)],
    services: ServicesDep,
    last_event_id: Annotated[
        int,
        Header(
            ge=0,
            le=2**31 - 1,
            description="go on after this event; browsers send it by themselves when they reconnect",
        ),
    ] = 0,
) -> AsyncIterator[ServerSentEvent]:
    """Everything that has happened, then everything as it happens. Ends when the job has ended."""
    after = last_event_id
    while True:
        found, complete = await run_in_threadpool(services.jobs.events, job_id, after)
        for event in found:
            out = EventOut.of(event)
            yield ServerSentEvent(data=out.model_dump(mode="json"), event=out.kind, id=str(out.sequence))
            after = event.sequence
        if complete:
            return
        await asyncio.sleep(_LOOK_EVERY_S)


def _out(job: Job) -> JobOut:
    return JobOut.of(job, time.time())


def _begun(services: Services, job: Job, due: Sequence[StageKey]) -> JobOut:
    """Settle at once what needs no work, and leave the rest to the workers."""
    to_do = services.reuse.settle(due)
    services.queue.dispatch(to_do)
    return _out(job if to_do == list(due) else services.jobs.job(job.id))


def _planned(services: Services, plan: Sequence[PlannedStage]) -> list[PlannedStageOut]:
    return [
        PlannedStageOut.of(planned, reuse=services.stages.find(planned.name, planned.hash) is not None)
        for planned in plan
    ]


def _restart_plan(
    services: Services, job_id: str, body: RestartIn
) -> tuple[dict[str, object], tuple[PlannedStage, ...]]:
    job = services.jobs.job(job_id)
    options = dict(job.options if body.options is None else body.options)
    if body.from_stage is not None:
        downstream(body.from_stage)  # refuses stages that do not exist
    if job.kind is JobKind.RUN:
        return options, services.runs.plan_again(job, options)
    return options, plan_stages(job.site, options, job.files)
