"""What a job has produced."""

from __future__ import annotations

import base64
import time
from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse

from api.paging import PageDep
from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.schemas import ArtifactOut, JobOut, ReportLinkOut
from api.services import Services, ServicesDep
from api.streams import STREAMS, BlocksResponse
from api.track_parameters import AskedTracks
from wibam_core.adapters.glimpses import GlimpseRequest, ReviewedConflicts
from wibam_core.adapters.results import ResultFile, archive_of, conflicts_csv
from wibam_core.adapters.track_query import TrackQuery, cursor_of, parse_cursor, query_tracks
from wibam_core.artifacts import catalogue
from wibam_core.documents.conflicts import Conflicts
from wibam_core.documents.metrics import Metrics
from wibam_core.documents.tracks import TrackPage
from wibam_core.errors import Conflict
from wibam_core.formats.archive import zip_blocks
from wibam_core.jobs.records import Job

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"], responses=documented(401, 404, 409))
public_router = APIRouter(tags=["results"])
_PAGE = 1000
_HTML: dict[int | str, dict[str, Any]] = {200: {"content": {"text/html": {}}}}
#: A report is our own file, but what is in it came from users' recordings: it may run scripts, and reach nothing.
_REPORT_HEADERS = {
    "Content-Security-Policy": "sandbox allow-scripts; default-src 'none'; img-src data:; font-src data:; "
    "style-src 'unsafe-inline'; script-src 'unsafe-inline'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


class WantedFiles:
    """Which of a job's files are asked for."""

    def __init__(
        self,
        stage: Annotated[list[str] | None, Query(max_length=100, description="written by any of these stages")] = None,
        artifact: Annotated[
            list[str] | None, Query(max_length=100, description="that are a part of any of these")
        ] = None,
    ) -> None:
        self._stages, self._artifacts = stage or (), artifact or ()

    def of(self, files: Iterable[ResultFile]) -> list[ResultFile]:
        """Those of them that are."""
        return [
            file
            for file in files
            if (not self._stages or file.stage in self._stages)
            and (not self._artifacts or file.artifact.name in self._artifacts)
        ]


WantedFilesDep = Annotated[WantedFiles, Depends()]


@router.get("/metrics", summary="How good the model is")
def metrics(job_id: str, services: ServicesDep) -> Metrics:
    """Baseline and fine-tuned, both evaluators."""
    return services.results.read(services.jobs.job(job_id), catalogue.METRICS)


@router.get(
    "/model",
    summary="Download the fine-tuned model",
    response_class=FileResponse,
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(422),
)
def model(job_id: str, services: ServicesDep, format: Literal["safetensors", "onnx"] = "safetensors") -> FileResponse:
    """safetensors or ONNX. The headers tell the job, the address of the stage's outputs, and the SHA-256."""
    job = services.jobs.job(job_id)
    file = services.results.file(job, catalogue.WEIGHTS_ONNX if format == "onnx" else catalogue.WEIGHTS)
    stage = job.stage(file.stage)
    assert stage is not None
    extra = {"X-Wibam-Job": job.id, "X-Wibam-Site": job.site_id, "X-Wibam-Stage-Hash": stage.hash}
    return _download(file, f"{job.id}.{format}", extra)


@router.get(
    "/tracks",
    summary="7DoF tracks",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses={
        200: {
            "model": TrackPage,
            "content": {"text/csv": {}, "application/vnd.apache.parquet": {}},
            "description": "JSON in pages; CSV and Parquet whole, unless a limit is given",
        },
        **documented(422),
    },
)
def tracks(
    job_id: str,
    services: ServicesDep,
    asked: AskedTracks,
    format: Literal["json", "csv", "parquet"] = "json",
    limit: Annotated[int | None, Query(ge=1, le=100_000)] = None,
    cursor: Annotated[str | None, Query(description="`next` of the page before")] = None,
) -> Response:
    """States of vehicles over time: position, size, yaw, speed, and the standard deviation of each."""
    page = limit if limit is not None else _PAGE if format == "json" else None
    query = replace(asked, after=parse_cursor(cursor) if cursor is not None else None, limit=page)
    job = services.jobs.job(job_id)
    path = services.results.file(job, catalogue.TRACKS).path
    if format == "json":
        return JSONResponse(_page(path, query))
    name = f"{job.id}-tracks.{format}"
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    stream, media_type = STREAMS[format]
    return StreamingResponse(stream(query_tracks(path, query)), media_type=media_type, headers=headers)


@router.get(
    "/conflicts",
    summary="Conflicts between road users",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses={200: {"model": Conflicts, "content": {"text/csv": {}, "application/pdf": {}}}, **documented(503)},
)
def conflicts(
    job_id: str,
    services: ServicesDep,
    format: Literal["json", "csv", "pdf"] = "json",
    reviews: Annotated[bool, Query(description="in CSV and PDF: columns with what people said of each")] = False,
) -> Response:
    """Pairs of vehicles whose time to collision or post-encroachment time fell below the thresholds, with intervals."""
    job = services.jobs.job(job_id)
    document = services.results.read(job, catalogue.CONFLICTS)
    if format == "json":
        return Response(document.model_dump_json(), media_type="application/json")
    headers = {"Content-Disposition": f'attachment; filename="{job.id}-conflicts.{format}"'}
    stage = job.stage(catalogue.CONFLICTS.stage)
    said = services.reviews.reviews(job.id, stage.hash) if reviews and stage is not None else None
    verdicts = None if said is None else {one.conflict_id: (one.verdict.value, one.note) for one in said}
    if format == "pdf":
        about = f"Site {job.site.name} · {job.id}"
        table = ReviewedConflicts(heading=job.name or job.id, about=about, conflicts=document, reviews=verdicts)
        _, pdf = services.glimpses.look(GlimpseRequest(look="conflicts"), table.model_dump_json().encode())
        return Response(pdf, media_type="application/pdf", headers=headers)
    return StreamingResponse(conflicts_csv(document, verdicts), media_type="text/csv; charset=utf-8", headers=headers)


@router.get(
    "/artifacts",
    summary="List the files of a job",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(422),
)
def artifacts(job_id: str, services: ServicesDep, page: PageDep, wanted: WantedFilesDep) -> list[ArtifactOut]:
    """Everything that its finished stages wrote, by its id."""
    files = wanted.of(services.results.files(services.jobs.job(job_id)))
    return [ArtifactOut.of(file) for file in page.of_all(files, lambda file: (file.id,), str)]


@router.get(
    "/archive",
    summary="Download a job's files as one zip archive",
    response_class=StreamingResponse,
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses={200: {"content": {"application/zip": {}}, "description": "A zip archive"}, **documented(422)},
)
def archive(job_id: str, services: ServicesDep, wanted: WantedFilesDep) -> StreamingResponse:
    """Everything that its finished stages wrote until now, in a folder with its id, with `job.json` (the job as it is)
    and `SHA256SUMS`. It is sent while it is made. Frames are much the largest part: ask for other stages where they are
    not needed.
    """
    job = services.jobs.job(job_id)
    files = wanted.of(services.results.files(job))
    if not files:
        raise Conflict(f"job {job_id} has no such files", hint="Wait until a stage has finished, or ask for others.")
    described = JobOut.of(job, time.time()).model_dump_json(indent=1).encode()
    blocks = zip_blocks(archive_of(job, files, described))
    return BlocksResponse(blocks, f"{job_id}.zip", blocks.close)


@router.get("/artifacts/{stage}/{name:path}", summary="Download a file of a job", response_class=FileResponse)
def artifact(job_id: str, stage: str, name: str, services: ServicesDep) -> FileResponse:
    """By its id, `<stage>/<name>`. Ranges are served."""
    found = services.results.named(services.jobs.job(job_id), stage, name)
    return _download(found, f"{job_id}-{found.path.name}")


@router.get(
    "/report", summary="The report", response_class=FileResponse, responses={200: {"content": {"text/html": {}}}}
)
def report(job_id: str, services: ServicesDep) -> FileResponse:
    """One self-contained HTML file."""
    return _report(services, services.jobs.job(job_id))


@router.get("/report-link", summary="A link to the report for a browser")
def report_link(job_id: str, services: ServicesDep) -> ReportLinkOut:
    """Works without a token, for ten minutes, for this one report."""
    services.results.file(services.jobs.job(job_id), catalogue.REPORT)
    expires, signature = services.report_links.sign(job_id)
    return ReportLinkOut(
        url=f"/reports/{job_id}?expires={expires}&signature={signature}",
        expires_at=datetime.fromtimestamp(expires, UTC),
    )


@public_router.get(
    "/reports/{job_id}",
    summary="The report, by link",
    response_class=FileResponse,
    responses={**_HTML, **documented(401, 404, 409)},
)
def report_by_link(job_id: str, expires: int, signature: str, services: ServicesDep) -> FileResponse:
    """See `GET /v1/jobs/{job_id}/report-link`."""
    services.report_links.verify(job_id, expires, signature)
    return _report(services, services.jobs.job(job_id))


def _report(services: Services, job: Job) -> FileResponse:
    path = services.results.file(job, catalogue.REPORT).path
    return FileResponse(path, media_type="text/html; charset=utf-8", headers=_REPORT_HEADERS)


def _download(file: ResultFile, filename: str, extra: dict[str, str] | None = None) -> FileResponse:
    digest = base64.b64encode(bytes.fromhex(file.sha256)).decode()
    headers = {
        "ETag": f'"{file.sha256}"',
        "Repr-Digest": f"sha-256=:{digest}:",
        "X-Content-Type-Options": "nosniff",
        "Content-Security-Policy": "sandbox",
        **(extra or {}),
    }
    return FileResponse(file.path, media_type=file.artifact.codec.media_type, filename=filename, headers=headers)


def _page(path: Path, query: TrackQuery) -> dict[str, Any]:
    with query_tracks(path, query) as batches:
        states = [state for batch in batches for state in batch.to_pylist()]
    last = states[-1] if len(states) == query.limit else None
    return {"states": states, "next": cursor_of(last["time_ns"], last["track_id"]) if last else None}
