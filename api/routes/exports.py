"""What a job has produced, in the formats of others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from fastapi import APIRouter, Path, Query
from starlette.responses import StreamingResponse

from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.services import Services, ServicesDep
from api.streams import BINARY, BlocksResponse
from wibam_core.documents.exports import BoxSource, ExportOffer

if TYPE_CHECKING:  # formats take long to import, and a service starts often without being asked for one
    from wibam_core.exports import ExportSource

router = APIRouter(prefix="/v1/jobs/{job_id}/exports", tags=["results"], responses=documented(401, 404, 409))
_FILE: dict[int | str, dict[str, Any]] = {
    200: {"content": {BINARY: {}, "application/zip": {}}, "description": "A file, or a zip archive of several"}
}


@router.get("", summary="List the formats that a job can be exported in")
def exports(job_id: str, services: ServicesDep) -> list[ExportOffer]:
    """All formats, with what each loses, and what is still missing for it."""
    from wibam_core.exports import offers

    return offers(_source(services, job_id))


def _name_all(schema: dict[str, Any]) -> None:
    """Name the formats in OpenAPI."""
    from wibam_core.exchange.registry import FORMATS

    schema["enum"] = list(FORMATS)


@router.get(
    "/{format}",
    summary="Results in a format of others",
    response_class=StreamingResponse,
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses={**_FILE, **documented(422)},
)
def export(
    job_id: str,
    format: Annotated[str, Path(json_schema_extra=_name_all)],
    services: ServicesDep,
    boxes: Annotated[BoxSource, Query(description="which 3D boxes, in formats that hold some")] = BoxSource.FITS,
) -> StreamingResponse:
    """One file, or a zip archive where the format has several. `GET /v1/jobs/{job_id}/exports` lists the formats."""
    from wibam_core.exports import open_export

    opened = open_export(format, _source(services, job_id), boxes)
    return BlocksResponse(opened.blocks, f"{job_id}-{opened.name}", opened.close, opened.size_bytes)


def _source(services: Services, job_id: str) -> ExportSource:
    from wibam_core.exports import ExportSource

    job = services.jobs.job(job_id)
    labels = job.assets.get("labels")
    return ExportSource(
        job.site, services.results.finished(job), None if labels is None else services.folder.file(labels)
    )
