"""Networks as things of their own, and runs of them on new footage."""

from __future__ import annotations

import base64
import time
from typing import Annotated, Literal

from fastapi import APIRouter, Header, Query, Request, Response
from starlette.responses import FileResponse

from api.addresses import address
from api.bodies import BoundedJsonRoute
from api.job_lists import JobFilterDep, list_jobs
from api.model_schemas import FootageChangeIn, FootageOut, ModelChangeIn, ModelIn, ModelOut, RunIn
from api.paging import MadeDep, PageDep, Text, Time
from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.schemas import JobOut
from api.services import ServicesDep
from api.times import parse_time
from wibam_core.adapters.runs import RunRequest
from wibam_core.documents.comparison import NetworkComparison
from wibam_core.errors import InputError, NotFound
from wibam_core.job_kind import JobKind
from wibam_core.jobs.records import ModelState

router = APIRouter(prefix="/v1/models", tags=["models"], responses=documented(401), route_class=BoundedJsonRoute)
footage_router = APIRouter(
    prefix="/v1/sites/{site_id}/footage", tags=["models"], responses=documented(401, 404), route_class=BoundedJsonRoute
)


@router.get("", summary="List models", dependencies=[ONLY_KNOWN_PARAMETERS], responses=documented(404, 422))
def list_models(
    services: ServicesDep,
    page: PageDep,
    made: MadeDep,
    site: Annotated[str | None, Query(description="of this site alone")] = None,
    job: Annotated[str | None, Query(description="made by this job")] = None,
    state: Annotated[list[ModelState] | None, Query(max_length=10, description="in any of these states")] = None,
    text: Text = "",
) -> list[ModelOut]:
    """The newest first. Every job that has fine-tuned, evaluated and used a network has one here."""
    services.keeper.keep_all()
    found = services.models.models(
        site, page.one_more, job_id=job, states=state or (), text=text, made=made, after=page.place
    )
    return [ModelOut.of(model) for model in page.cut(found, lambda model: (model.created_at, model.id))]


@router.post("", status_code=201, summary="Keep a model", responses=documented(404, 409, 413, 422, 503))
def keep(body: ModelIn, services: ServicesDep, request: Request, response: Response) -> ModelOut:
    """An upload is opened by a process that reaches nothing else, and kept if it holds a network (safetensors). Its
    ONNX file is made there, too. The upload is used up. If the site has a network with the same file, it is that one.
    """
    if body.job_id is not None and body.file_id is None and body.site_id is None:
        job = services.jobs.job(body.job_id)
        model = services.keeper.keep_of_job(job) or services.models.models(job_id=job.id, limit=1)[0]
        if body.name:
            model = services.models.change(model.id, name=body.name)
    elif body.job_id is None and body.file_id is not None and body.site_id is not None:
        files = {file.id: file for file in services.sites.all_files(body.site_id)}
        if body.file_id not in files:
            raise NotFound(
                f"site {body.site_id} has no file {body.file_id}", hint="Upload it with the purpose 'model'."
            )
        model = services.keeper.keep_upload(files[body.file_id], body.name)
    else:
        raise InputError("a model comes from a job or from a file", hint="Send job_id, or site_id and file_id.")
    response.headers["Location"] = address(request, f"/v1/models/{model.id}")
    return ModelOut.of(model)


@router.get(
    "/compare",
    summary="Compare two models",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(404, 409, 422, 503),
)
def compare(
    services: ServicesDep,
    first: Annotated[str, Query(max_length=64, description="id of a model")],
    second: Annotated[str, Query(max_length=64, description="id of another one")],
) -> NetworkComparison:
    """Both on the same held-out instants: those of both jobs' test parts, judged by the same cameras, annotations and
    labels, which are the second's. Differences are its figures less the
    first's, with intervals by resampling vehicles. Their jobs must have worked
    on the same recordings.
    """
    return services.comparing.compare(first, second)


@router.get("/{model_id}", summary="Look at a model", responses=documented(404))
def get(model_id: str, services: ServicesDep) -> ModelOut:
    """With its card: where it comes from, what it learned from and how, how good it is, under which terms."""
    return ModelOut.of(services.models.model(model_id))


@router.patch("/{model_id}", summary="Rename, promote or retire a model", responses=documented(404, 422))
def change(model_id: str, body: ModelChangeIn, services: ServicesDep) -> ModelOut:
    return ModelOut.of(services.models.change(model_id, name=body.name, state=body.state))


@router.delete("/{model_id}", status_code=204, summary="Delete a model", responses=documented(404, 409))
def delete(model_id: str, services: ServicesDep) -> None:
    """Tracks and conflicts that it found stay. A model that a run works with is kept (409)."""
    services.keeper.delete(model_id)


@router.get(
    "/{model_id}/file",
    summary="Download a model",
    response_class=FileResponse,
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(404, 422),
)
def file(model_id: str, services: ServicesDep, format: Literal["safetensors", "onnx"] = "safetensors") -> FileResponse:
    """safetensors or ONNX; both carry the card. Ranges are served."""
    model = services.models.model(model_id)
    headers = {"X-Content-Type-Options": "nosniff", "Content-Security-Policy": "sandbox", "X-Wibam-Site": model.site_id}
    if format == "safetensors":
        headers["ETag"] = f'"{model.sha256}"'
        headers["Repr-Digest"] = f"sha-256=:{base64.b64encode(bytes.fromhex(model.sha256)).decode()}:"
    path = services.keeper.file(model, format)
    return FileResponse(path, media_type="application/octet-stream", filename=f"{model.id}.{format}", headers=headers)


@router.post(
    "/{model_id}/runs", status_code=201, summary="Run a model on footage", responses=documented(404, 409, 413, 422)
)
def run(
    model_id: str,
    body: RunIn,
    services: ServicesDep,
    request: Request,
    response: Response,
    idempotency_key: Annotated[
        str | None,
        Header(max_length=255, description="a second request with the same key gets the run that the first one made"),
    ] = None,
) -> JobOut:
    """From footage of calibrated cameras to tracks and conflicts, without training, however long it is.

    A run is a job of the kind `run`: it is looked at, followed, cancelled, restarted and deleted under `/v1/jobs/{id}`,
    and so are its tracks and conflicts. Several files of a camera are one piece of footage; where all files say when
    they began, times are Unix time.
    """
    asked = RunRequest(body.files, body.options, body.site_id, body.continues, body.name, body.tags)
    job, ready = services.runs.create(model_id, asked, idempotency_key)
    services.queue.dispatch(services.reuse.settle(ready))
    response.headers["Location"] = address(request, f"/v1/jobs/{job.id}")
    return JobOut.of(services.jobs.job(job.id), time.time())


@router.get(
    "/{model_id}/runs",
    summary="List the runs of a model",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(422),
)
def runs(model_id: str, services: ServicesDep, page: PageDep, wanted: JobFilterDep) -> list[JobOut]:
    """The newest first."""
    return list_jobs(services, page, wanted, JobKind.RUN, model_id)


@footage_router.get(
    "", summary="List the footage of a site", dependencies=[ONLY_KNOWN_PARAMETERS], responses=documented(422)
)
def footage(
    site_id: str,
    services: ServicesDep,
    page: PageDep,
    camera: Annotated[str | None, Query(description="of this camera alone")] = None,
    start: Annotated[Time, Query(alias="from", description="that began then or later; ISO 8601 with offset")] = None,
    end: Annotated[Time, Query(alias="to", description="that began before")] = None,
) -> list[FootageOut]:
    """By camera, then by name: what was uploaded with the purpose `footage`, and the recordings. Files of which nobody
    said when they began are left out where a time is asked for.
    """
    first_ns, last_ns = (None if text is None else parse_time(text) for text in (start, end))
    files = [
        file
        for file in services.sites.footage(site_id)
        if (camera is None or file.camera_id == camera)
        and (first_ns is None or (file.started_ns is not None and file.started_ns >= first_ns))
        and (last_ns is None or (file.started_ns is not None and file.started_ns < last_ns))
    ]
    found = page.of_all(files, lambda file: (file.camera_id, file.filename, file.id), *[str] * 3)
    return [FootageOut.of(file) for file in found]


@footage_router.patch("/{file_id}", summary="Say when footage began", responses=documented(422))
def date(site_id: str, file_id: str, body: FootageChangeIn, services: ServicesDep) -> FootageOut:
    """Runs and jobs that were made before are not changed by it."""
    started_ns = None if body.started_at is None else parse_time(body.started_at)
    return FootageOut.of(services.sites.date_file(site_id, file_id, started_ns))


@footage_router.delete("/{file_id}", status_code=204, summary="Delete footage")
def delete_footage(site_id: str, file_id: str, services: ServicesDep) -> None:
    """Runs that were made with the file keep it until they are deleted."""
    services.sites.retire_file(site_id, file_id)
