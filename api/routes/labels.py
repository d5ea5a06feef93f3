"""Hand labels of a job's instants: read, save, propose, suggest, compare, export, evaluate with."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path as FilePath
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import APIRouter, Header, Path, Query, Response
from pydantic import BaseModel, ConfigDict, Field

from api.bodies import BoundedJsonRoute
from api.paging import PageDep
from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.schemas import JobOut
from api.services import Services, ServicesDep
from api.streams import BlocksResponse
from wibam_core.adapters.label_store import LabelSet, LabelVersion
from wibam_core.adapters.planning import plan_stages
from wibam_core.adapters.site_store import UploadRequest
from wibam_core.artifacts import catalogue
from wibam_core.documents.hand_labels import Agreement, HandLabels, HandRegions, HandVehicle, HandVehicles, Suggestion
from wibam_core.errors import Conflict, InputError, NotFound
from wibam_core.formats.labels import write_labels
from wibam_core.jobs.records import Job, Purpose
from wibam_core.scene import FrameSet
from wibam_core.stages.recording_files import digest_of

if TYPE_CHECKING:  # what computes with labels takes long to import, and a service starts often without being asked
    from wibam_core.scene import LabelledInstant

router = APIRouter(
    prefix="/v1/jobs/{job_id}/labels",
    tags=["labels"],
    responses=documented(401, 404, 409),
    route_class=BoundedJsonRoute,
)
TimeNs = Annotated[int, Path(ge=-(2**62), le=2**62, description="the instant, ns on the reference clock")]
_SET_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"
SetName = Annotated[
    str, Query(alias="set", pattern=_SET_PATTERN, description="whose labels: two people who compare use two sets")
]
_OWN = {"parquet": "labels.parquet", "json": "labels.json"}


class LabelsIn(BaseModel):
    """Labels of an instant, as you leave them."""

    model_config = ConfigDict(extra="forbid")

    author: str = Field(min_length=1, max_length=100, description="who made them")
    vehicles: HandVehicles
    regions: HandRegions = ()
    finished: bool = Field(False, description="every road user is labelled that a camera sees")
    seconds: float = Field(0.0, ge=0, le=1e7, description="how long you worked on the instant, all together")


class LabelsOut(BaseModel):
    """Labels of an instant."""

    version: int = Field(description="counts from 1; 0 where nobody has labelled the instant")
    author: str
    saved_at: datetime | None
    labels: HandLabels
    visibility: dict[str, list[float]] = Field(
        description="camera -> for each vehicle the share that it sees: as given by hand, else as estimated from the "
        "boxes before it, hidden regions and the border of the image"
    )


class LabelVersionOut(BaseModel):
    """That somebody saved something."""

    version: int
    author: str
    saved_at: datetime
    vehicles: int
    finished: bool


class LabelledInstantOut(LabelVersionOut):
    """The newest labels of an instant, in short."""

    time_ns: int
    seconds: float = Field(description="how long people worked on it")
    in_job: bool = Field(
        description="whether the job has frames of it; others of the footage were labelled through others"
    )


class LabelsSummaryOut(BaseModel):
    """What is labelled."""

    sets: list[str] = Field(description="names of all sets of labels of this footage")
    instants: list[LabelledInstantOut]


class EvaluateIn(BaseModel):
    """Which labels to evaluate with."""

    model_config = ConfigDict(extra="forbid")

    label_set: str = Field("main", alias="set", pattern=_SET_PATTERN)


@router.get("", summary="List what is labelled", dependencies=[ONLY_KNOWN_PARAMETERS], responses=documented(422))
def summary(job_id: str, services: ServicesDep, name: SetName = "main") -> LabelsSummaryOut:
    """Labels belong to the site and the recording of its reference camera: all jobs on it show the same."""
    job = services.jobs.job(job_id)
    of = _set(job, name)
    has_frames = services.results.has(job, catalogue.FRAMES)
    own = {instant.time_ns for instant in services.results.frames(job).frame_sets} if has_frames else frozenset[int]()
    return LabelsSummaryOut(
        sets=services.labels.sets(of.site_id, of.footage),
        instants=[
            LabelledInstantOut(
                **_short(version),
                time_ns=version.labels.time_ns,
                seconds=round(version.labels.seconds, 1),
                in_job=version.labels.time_ns in own,
            )
            for version in services.labels.latest(of)
        ],
    )


@router.get(
    "/suggestions",
    summary="Which instants to label",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(422),
)
def suggestions(
    job_id: str, services: ServicesDep, name: SetName = "main", count: Annotated[int, Query(ge=1, le=500)] = 20
) -> list[Suggestion]:
    """Of the test part, the only one that labels evaluate: spread over it, and more where the cameras disagree. What is
    labelled already is not suggested again."""
    from wibam_core.labelling.suggestions import suggest

    job = services.jobs.job(job_id)
    split = services.results.read(job, catalogue.SPLIT)
    return suggest(
        split.times_ns["test"],
        {fit.time_ns: fit for fit in services.results.read(job, catalogue.FITS)},
        {instant.time_ns: instant for instant in services.results.read(job, catalogue.ANNOTATIONS)},
        services.results.read(job, catalogue.RIG),
        count,
        {version.labels.time_ns for version in services.labels.latest(_set(job, name))},
    )


@router.get("/instants/{time_ns}", summary="Labels of an instant", responses=documented(422))
def labels(
    job_id: str,
    time_ns: TimeNs,
    services: ServicesDep,
    response: Response,
    name: SetName = "main",
    version: Annotated[
        int | None, Query(ge=1, le=2**31 - 1, description="an earlier one; the newest otherwise")
    ] = None,
) -> LabelsOut:
    """The header `ETag` has the version, for the `If-Match` of saving."""
    job = services.jobs.job(job_id)
    _frames_at(services, job, time_ns)
    of = _set(job, name)
    if version is None:
        return _out(services, job, services.labels.newest(of, time_ns), time_ns, response)
    for one in services.labels.versions(of, time_ns):
        if one.version == version:
            return _out(services, job, one, time_ns, response)
    raise NotFound(f"there is no version {version} of these labels", hint="Its versions are listed by /versions.")


@router.get(
    "/instants/{time_ns}/versions",
    summary="Who saved an instant's labels when",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(422),
)
def versions(
    job_id: str, time_ns: TimeNs, services: ServicesDep, page: PageDep, name: SetName = "main"
) -> list[LabelVersionOut]:
    """The oldest first. None is ever changed."""
    found = services.labels.versions(_set(services.jobs.job(job_id), name), time_ns)
    return [LabelVersionOut(**_short(one)) for one in page.of_all(found, lambda one: (one.version,), int)]


@router.get("/instants/{time_ns}/proposal", summary="What to start labelling from", responses=documented(422))
def proposal(job_id: str, time_ns: TimeNs, services: ServicesDep) -> list[HandVehicle]:
    """The boxes that the job fitted to all views, moved to the instant where it lies between two fits: to be looked at
    and corrected, each of them."""
    from wibam_core.labelling.proposal import proposed

    job = services.jobs.job(job_id)
    _frames_at(services, job, time_ns)
    fits = services.results.read(job, catalogue.FITS)
    return proposed(fits, time_ns)


@router.put("/instants/{time_ns}", summary="Save the labels of an instant", responses=documented(412, 413, 422))
def save(
    job_id: str,
    time_ns: TimeNs,
    body: LabelsIn,
    services: ServicesDep,
    response: Response,
    if_match: Annotated[
        str, Header(max_length=40, description='the `ETag` that your labels were made from; `"0"` where there are none')
    ],
    name: SetName = "main",
) -> LabelsOut:
    """Adds a version. Where somebody else has saved meanwhile, nothing is changed (412, `changed_meanwhile`)."""
    job = services.jobs.job(job_id)
    _frames_at(services, job, time_ns)
    given = HandLabels(
        time_ns=time_ns,
        vehicles=body.vehicles,
        regions=body.regions,
        finished=body.finished,
        seconds=round(body.seconds, 1),
    )
    saved = services.labels.save(_set(job, name), given, body.author, _version_of(if_match))
    return _out(services, job, saved, time_ns, response)


@router.get("/agreement", summary="How far two people agree", responses=documented(422))
def agreement(
    job_id: str,
    services: ServicesDep,
    first: Annotated[str, Query(pattern=_SET_PATTERN, description="name of a set")],
    second: Annotated[str, Query(pattern=_SET_PATTERN, description="name of another")],
) -> Agreement:
    """Over the instants that both have finished."""
    from wibam_core.labelling.agreement import agreement as compare

    job = services.jobs.job(job_id)
    one, other = ([v.labels for v in services.labels.latest(_set(job, name))] for name in (first, second))
    return compare(one, other, services.results.read(job, catalogue.RIG))


def _name_formats(schema: dict[str, Any]) -> None:
    """Name the formats in OpenAPI."""
    from wibam_core.exchange.registry import FORMATS

    schema["enum"] = [*_OWN, *FORMATS]


@router.get(
    "/export/{format}",
    summary="Finished labels as a file",
    response_class=Response,
    responses={
        200: {"content": {"application/octet-stream": {}, "application/zip": {}}, "description": "A file"},
        **documented(422),
    },
)
def export(
    job_id: str,
    format: Annotated[str, Path(json_schema_extra=_name_formats)],
    services: ServicesDep,
    name: SetName = "main",
) -> Response:
    """`parquet` and `json` are this project's own label files, the others exchange formats: their 2D boxes are the
    labels, reprojected into the cameras that see them."""
    from wibam_core.exchange.registry import format_of
    from wibam_core.exports import Export, native_jpeg
    from wibam_core.labelling.labels import content_of

    job = services.jobs.job(job_id)
    finished = _finished(services, job, name)
    if format in _OWN:
        media_type = "application/json" if format == "json" else "application/vnd.apache.parquet"
        headers = {"Content-Disposition": f'attachment; filename="{job.id}-{_OWN[format]}"'}
        return Response(_file(finished, _OWN[format]), media_type=media_type, headers=headers)
    fmt = format_of(format)
    store = services.results.frames(job)
    frames = {one.time_ns: one for one in store.frame_sets}
    there = [labels for labels in finished if labels.vehicles.time_ns in frames]
    rig = services.results.read(job, catalogue.RIG)
    opened = Export(fmt, content_of(job.site, rig, there, frames, native_jpeg(store)))
    return BlocksResponse(opened.blocks, f"{job_id}-labels-{opened.name}", opened.close, opened.size_bytes)


@router.post("/evaluate", status_code=202, summary="Evaluate a job with hand labels", responses=documented(413, 422))
def evaluate(job_id: str, body: EvaluateIn, services: ServicesDep) -> JobOut:
    """The finished labels become the site's labels file, in place of one that was uploaded, and the job runs again from
    where labels matter: it is evaluated and reported anew, and trains nothing."""
    job = services.jobs.job(job_id)
    if not job.state.is_terminal:
        raise Conflict(f"job {job_id} is {job.state}", hint="Cancel it first, or wait until it has ended.")
    data = _file(_finished(services, job, body.label_set), _OWN["parquet"])
    request = UploadRequest(job.site_id, Purpose.LABELS, "", f"{body.label_set}-labels.parquet", len(data))
    upload = services.uploads.create(request)
    with services.uploads.piece(upload.id, 0) as piece:
        piece.write(data)
        piece.finish()
    [file] = [one for one in services.sites.files(job.site_id) if one.id == upload.id]
    files = (*(one for one in job.files if one.purpose is not Purpose.LABELS), file)
    options = dict(job.options)
    job, ready = services.jobs.restart(job_id, options, plan_stages(job.site, options, files), files=files)
    services.queue.dispatch(services.reuse.settle(ready))
    return JobOut.of(job, datetime.now(UTC).timestamp())


def _set(job: Job, name: str) -> LabelSet:
    """The labels of the job's footage that go by a name."""
    reference = job.recordings[job.site.camera_ids[0]]
    return LabelSet(job.site_id, digest_of((file.filename, file.sha256) for file in reference), name)


def _frames_at(services: Services, job: Job, time_ns: int) -> FrameSet:
    """Raises:
    NotFound: there are no frames of this instant.
    """
    for instant in services.results.frames(job).frame_sets:
        if instant.time_ns == time_ns:
            return instant
    raise NotFound(f"job {job.id} has no instant at {time_ns} ns", hint=f"GET /v1/jobs/{job.id}/instants lists them.")


def _version_of(etag: str) -> int:
    """Raises:
    InputError: it is no ETag of labels.
    """
    number = etag.strip().strip('"')
    if not number.isdecimal() or len(number) > 9:
        raise InputError(f"If-Match {etag!r} is not the ETag of labels", hint="Read the labels first; GET says it.")
    return int(number)


def _finished(services: Services, job: Job, name: str) -> list[LabelledInstant]:
    """Raises:
    Conflict: no instant is finished.
    """
    from wibam_core.labelling.labels import labelled_instants

    latest = [version.labels for version in services.labels.latest(_set(job, name))]
    if not any(labels.finished for labels in latest):
        raise Conflict(
            f"no instant is finished in the labels {name!r}",
            hint="Label at least one instant, and mark it as finished.",
        )
    return labelled_instants(latest, services.results.read(job, catalogue.RIG))


def _file(labels: Sequence[LabelledInstant], name: str) -> bytes:
    with TemporaryDirectory(prefix="wibam-labels-") as folder:
        path = FilePath(folder) / name
        write_labels(path, labels)
        return path.read_bytes()


def _out(services: Services, job: Job, version: LabelVersion | None, time_ns: int, response: Response) -> LabelsOut:
    from wibam_core.labelling.labels import visibility_of

    labels = version.labels if version is not None else HandLabels(time_ns=time_ns)
    number = version.version if version is not None else 0
    response.headers["ETag"] = f'"{number}"'
    response.headers["Cache-Control"] = "no-store"
    seen = visibility_of(labels, services.results.read(job, catalogue.RIG))
    return LabelsOut(
        version=number,
        author=version.author if version is not None else "",
        saved_at=datetime.fromtimestamp(version.saved_at, UTC) if version is not None else None,
        labels=labels,
        visibility={camera_id: [round(share, 3) for share in shares.tolist()] for camera_id, shares in seen.items()},
    )


def _short(version: LabelVersion) -> dict[str, Any]:
    return {
        "version": version.version,
        "author": version.author,
        "saved_at": datetime.fromtimestamp(version.saved_at, UTC),
        "vehicles": len(version.labels.vehicles),
        "finished": version.labels.finished,
    }
