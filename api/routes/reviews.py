"""What people say of a job's conflicts."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Path
from pydantic import BaseModel, ConfigDict, Field

from api.paging import PageDep
from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.services import Services, ServicesDep
from wibam_core.adapters.review_store import ConflictReview, Verdict
from wibam_core.artifacts import catalogue
from wibam_core.errors import NotFound

router = APIRouter(prefix="/v1/jobs/{job_id}/conflicts", tags=["results"], responses=documented(401, 404, 409))
ConflictId = Annotated[int, Path(ge=0, le=2**31 - 1)]


class ReviewIn(BaseModel):
    """What you say of a conflict."""

    model_config = ConfigDict(extra="forbid")

    verdict: Verdict
    note: str = Field("", max_length=2000)


class ReviewOut(BaseModel):
    """What somebody said of a conflict."""

    conflict_id: int
    verdict: Verdict
    note: str
    reviewed_at: datetime

    @classmethod
    def of(cls, review: ConflictReview) -> ReviewOut:
        return cls(
            conflict_id=review.conflict_id,
            verdict=review.verdict,
            note=review.note,
            reviewed_at=datetime.fromtimestamp(review.reviewed_at, UTC),
        )


@router.get(
    "/reviews",
    summary="List the reviews of conflicts",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(422),
)
def reviews(job_id: str, services: ServicesDep, page: PageDep) -> list[ReviewOut]:
    """Of the conflicts as they are now: when the job's safety stage makes others, reviews of the earlier ones are kept,
    and come back with them."""
    found = services.reviews.reviews(job_id, _hash(services, job_id))
    return [ReviewOut.of(review) for review in page.of_all(found, lambda review: (review.conflict_id,), int)]


@router.put("/{conflict_id}/review", summary="Review a conflict", responses=documented(422))
def review(job_id: str, conflict_id: ConflictId, body: ReviewIn, services: ServicesDep) -> ReviewOut:
    """In place of the review before, if there was one."""
    _check(services, job_id, conflict_id)
    hash = _hash(services, job_id)
    return ReviewOut.of(services.reviews.say(job_id, hash, conflict_id, body.verdict, body.note))


@router.delete("/{conflict_id}/review", status_code=204, summary="Take a review back")
def forget(job_id: str, conflict_id: ConflictId, services: ServicesDep) -> None:
    services.reviews.forget(job_id, _hash(services, job_id), conflict_id)


def _hash(services: Services, job_id: str) -> str:
    """The address of the outputs that hold the job's conflicts."""
    job = services.jobs.job(job_id)
    services.results.file(job, catalogue.CONFLICTS)
    stage = job.stage(catalogue.CONFLICTS.stage)
    assert stage is not None
    return stage.hash


def _check(services: Services, job_id: str, conflict_id: int) -> None:
    """Raises:
    NotFound: the job has no such conflict.
    """
    document = services.results.read(services.jobs.job(job_id), catalogue.CONFLICTS)
    if all(conflict.conflict_id != conflict_id for conflict in document.conflicts):
        raise NotFound(
            f"job {job_id} has no conflict {conflict_id}", hint=f"GET /v1/jobs/{job_id}/conflicts lists them."
        )
