"""Video clips of what the player shows: asked for here, rendered by a worker."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel, Field
from starlette.responses import FileResponse

from api.addresses import address
from api.bodies import BoundedJsonRoute
from api.paging import MadeDep, PageDep
from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.schemas import ErrorOut
from api.services import Services, ServicesDep
from wibam_core.artifacts import catalogue
from wibam_core.documents.clips import ClipFacts, ClipSpec
from wibam_core.errors import Conflict, NotFound
from wibam_core.jobs.clips import Clip, ClipState

router = APIRouter(
    prefix="/v1/jobs/{job_id}/clips", tags=["results"], responses=documented(401, 404), route_class=BoundedJsonRoute
)
ClipId = Annotated[str, Path(pattern=r"^clip_[0-9a-f]{16}$")]
#: A second of clip takes at most about so much, and a clip is refused that the disk would not hold.
_BYTES_A_SECOND = 1_000_000


class ClipOut(BaseModel):
    """A clip that was asked for, and how it stands."""

    id: str = Field(examples=["clip_5e4d3c2b1a098765"])
    spec: ClipSpec
    state: ClipState
    fraction: float = Field(ge=0, le=1, description="done")
    message: str
    error: ErrorOut | None = Field(description="why it failed")
    facts: ClipFacts | None = Field(description="of the finished file")
    size_bytes: int | None
    outdated: bool = Field(description="the job has made other tracks since")
    created_at: datetime
    finished_at: datetime | None

    @classmethod
    def of(cls, clip: Clip, tracks_hash: str) -> ClipOut:
        return cls(
            id=clip.id,
            spec=clip.spec,
            state=clip.state,
            fraction=clip.fraction,
            message=clip.message,
            error=None if clip.error is None else ErrorOut.model_validate(clip.error),
            facts=clip.facts,
            size_bytes=clip.size_bytes,
            outdated=clip.tracks_hash != tracks_hash,
            created_at=datetime.fromtimestamp(clip.created_at, UTC),
            finished_at=None if clip.finished_at is None else datetime.fromtimestamp(clip.finished_at, UTC),
        )


@router.post("", status_code=202, summary="Ask for a video clip", responses=documented(409, 413, 422, 507))
def create(job_id: str, body: ClipSpec, services: ServicesDep, request: Request, response: Response) -> ClipOut:
    """The plan and all cameras' views in step over a stretch of time, with the road users drawn in, as H.264 in MP4.

    A worker renders it; `GET /v1/jobs/{job_id}/clips/{clip_id}` says how far it is.
    """
    job = services.jobs.job(job_id)
    services.results.file(job, catalogue.TRACKS)
    services.results.frames(job)
    services.folder.require_space(int(_BYTES_A_SECOND * (body.end_ns - body.start_ns) / 1e9 / body.speed))
    tracks_hash = _tracks_hash(services, job_id)
    clip = services.clips.create(job_id, tracks_hash, body)
    services.queue.dispatch_clips([clip.id])
    response.headers["Location"] = address(request, f"/v1/jobs/{job_id}/clips/{clip.id}")
    return ClipOut.of(clip, tracks_hash)


@router.get("", summary="List video clips", dependencies=[ONLY_KNOWN_PARAMETERS], responses=documented(422))
def clips(
    job_id: str,
    services: ServicesDep,
    page: PageDep,
    made: MadeDep,
    state: Annotated[list[ClipState] | None, Query(max_length=10, description="in any of these states")] = None,
) -> list[ClipOut]:
    """The newest first."""
    tracks_hash = _tracks_hash(services, job_id)
    found = services.clips.clips(job_id, page.one_more, states=state or (), made=made, after=page.place)
    return [ClipOut.of(clip, tracks_hash) for clip in page.cut(found, lambda clip: (clip.created_at, clip.id))]


@router.get("/{clip_id}", summary="Look at a video clip")
def clip(job_id: str, clip_id: ClipId, services: ServicesDep) -> ClipOut:
    return ClipOut.of(services.clips.clip(job_id, clip_id), _tracks_hash(services, job_id))


@router.get(
    "/{clip_id}/video",
    summary="Download a video clip",
    response_class=FileResponse,
    responses={200: {"content": {"video/mp4": {}}}, **documented(409)},
)
def video(job_id: str, clip_id: ClipId, services: ServicesDep) -> FileResponse:
    """As MP4; ranges of bytes can be asked for, so that players can jump."""
    clip = services.clips.clip(job_id, clip_id)
    if clip.state is not ClipState.SUCCEEDED:
        hint = "Ask for it again." if clip.state is ClipState.FAILED else "Wait until it has been rendered."
        raise Conflict(f"the clip {clip_id} is {clip.state}", hint=hint)
    path = services.folder.clip(clip_id)
    if not path.exists():
        raise NotFound(f"the file of the clip {clip_id} is gone", hint="Delete the clip, and ask for it again.")
    headers = {"X-Content-Type-Options": "nosniff", "Cache-Control": "private, max-age=86400"}
    return FileResponse(path, media_type="video/mp4", filename=f"{job_id}-{clip_id}.mp4", headers=headers)


@router.delete("/{clip_id}", status_code=204, summary="Delete a video clip")
def delete(job_id: str, clip_id: ClipId, services: ServicesDep) -> None:
    """One that is being rendered is stopped."""
    services.clips.delete(job_id, clip_id)
    services.folder.clip(clip_id).unlink(missing_ok=True)


def _tracks_hash(services: Services, job_id: str) -> str:
    stage = services.jobs.job(job_id).stage(catalogue.TRACKS.stage)
    return "" if stage is None else stage.hash
