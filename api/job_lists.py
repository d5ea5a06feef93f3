"""Which jobs a list shows."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Query

from api.paging import MadeDep, Page, Text
from api.schemas import JobOut, Tag
from api.services import Services
from wibam_core.adapters.paging import Span
from wibam_core.job_kind import JobKind
from wibam_core.jobs.states import JobState


@dataclass(frozen=True)
class JobFilter:
    """What the jobs of a list have in common; see the parameters."""

    site: str | None
    states: tuple[JobState, ...]
    text: str
    tags: tuple[str, ...]
    made: Span


def _filter(
    made: MadeDep,
    site: Annotated[str | None, Query(description="of this site alone")] = None,
    state: Annotated[list[JobState] | None, Query(max_length=10, description="in any of these states")] = None,
    text: Text = "",
    tag: Annotated[list[Tag] | None, Query(max_length=20, description="that have all of these tags")] = None,
) -> JobFilter:
    return JobFilter(site, tuple(state or ()), text, tuple(tag or ()), made)


JobFilterDep = Annotated[JobFilter, Depends(_filter)]


def list_jobs(
    services: Services, page: Page, wanted: JobFilter, kind: JobKind, model_id: str | None = None
) -> list[JobOut]:
    """A page of jobs, the newest first; runs of one network alone where ``model_id`` is given."""
    found = services.jobs.jobs(
        wanted.site,
        page.one_more,
        states=wanted.states,
        text=wanted.text,
        tags=wanted.tags,
        made=wanted.made,
        kind=kind,
        model_id=model_id,
        after=page.place,
    )
    now = time.time()
    return [JobOut.of(job, now) for job in page.cut(found, lambda job: (job.created_at, job.id))]
