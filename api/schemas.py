"""What the API says, as OpenAPI shows it. Times are ISO 8601 in UTC; durations are seconds."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from api.times import to_time
from wibam_core.adapters.machine import this_machine
from wibam_core.adapters.results import ResultFile
from wibam_core.adapters.site_maps import KeptMap
from wibam_core.config import PipelineConfig
from wibam_core.costs import Pace
from wibam_core.documents.recordings import VideoInfo
from wibam_core.documents.site_map import SiteMap
from wibam_core.documents.warnings import StageWarning
from wibam_core.job_kind import JobKind
from wibam_core.jobs.estimate import job_fraction, pace_of, remaining_s, stage_remaining_s
from wibam_core.jobs.records import Event, Job, Purpose, SiteRecord, StageRun, StoredFile
from wibam_core.jobs.states import JobState, StageState
from wibam_core.site import Origin, Site
from wibam_core.stages.graph import STAGES, PlannedStage


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)


def _time_or_none(seconds: float | None) -> datetime | None:
    return None if seconds is None else _time(seconds)


class MapOut(BaseModel):
    """A site's picture from above; its own address gives the picture."""

    map: SiteMap
    version: str = Field(description="changes with the picture and with its place")
    note: str = Field("", description="why its placing is left out: it was found by another origin than is asked for")

    @classmethod
    def of(cls, kept: KeptMap | None, origin: Origin | None) -> MapOut | None:
        """As it lies in a world with this origin."""
        if kept is None:
            return None
        seen = kept.seen_from(origin)
        return cls(map=seen.map, version=seen.version, note=seen.note)


class SiteOut(BaseModel):
    """A site, as it was described."""

    id: str = Field(examples=["site_3f0c9a1be2d44c70"])
    name: str
    cameras: list[str] = Field(description="camera ids; the first is the reference", examples=[["north", "south"]])
    created_at: datetime
    site: Site
    map: MapOut | None = Field(None, description="its picture from above, where it has one; lists leave it out")

    @classmethod
    def of(cls, record: SiteRecord, kept: KeptMap | None = None) -> SiteOut:
        return cls(
            id=record.id,
            name=record.site.name,
            cameras=list(record.site.camera_ids),
            created_at=_time(record.created_at),
            site=record.site,
            map=MapOut.of(kept, record.site.origin),
        )


class RecordingOut(BaseModel):
    """An uploaded file of a site."""

    id: str = Field(examples=["file_9b8a7c6d5e4f3a2b"])
    site_id: str
    purpose: Purpose
    camera: str | None = Field(description="of a recording or footage")
    filename: str = Field(description="as the client called it")
    size_bytes: int
    sha256: str
    created_at: datetime
    started_at: datetime | None = Field(None, description="when its first frame was taken, where somebody said it")
    probe: VideoInfo | None = Field(None, description="codec, size, rate, duration, once a job has looked")

    @classmethod
    def of(cls, file: StoredFile, probe: VideoInfo | None = None) -> RecordingOut:
        return cls(
            id=file.id,
            site_id=file.site_id,
            purpose=file.purpose,
            camera=file.camera_id or None,
            filename=file.filename,
            size_bytes=file.size_bytes,
            sha256=file.sha256,
            created_at=_time(file.created_at),
            started_at=None if file.started_ns is None else to_time(file.started_ns),
            probe=probe,
        )


#: Of anything that the service made; none has other signs.
Id = Annotated[str, Field(max_length=64, pattern=r"^[A-Za-z0-9_-]+$")]
JobName = Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]


Tag = Annotated[
    str,
    Field(
        min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]*[^\x00-\x20\x7f][^\x00-\x1f\x7f]*$", examples=["rain"]
    ),
]
Tags = Annotated[list[Tag], Field(max_length=20, description="words by which you find it again", examples=[["rain"]])]


class JobIn(BaseModel):
    """A job to create."""

    model_config = ConfigDict(extra="forbid")

    name: JobName = Field("", description="what you call it", examples=["Monday, second try"])
    tags: Tags = []
    options: dict[str, JsonValue] = Field(
        {},
        description="options by stage; what is left out has its default (`GET /v1/options`)",
        examples=[{"finetune": {"steps": 200}, "sync": {"method": "none"}}],
    )


class JobChangeIn(BaseModel):
    """What of a job can be changed: what it is called, and its tags. What is left out stays."""

    model_config = ConfigDict(extra="forbid")

    name: JobName | None = None
    tags: Tags | None = Field(None, description="in place of those that it has")


class RestartIn(BaseModel):
    """How to restart a job."""

    model_config = ConfigDict(extra="forbid")

    from_stage: str | None = Field(
        None, description="make this stage and all that follow from it anew, even if their outputs are there"
    )
    options: dict[str, JsonValue] | None = Field(None, description="other options than before; left out: the same")


class PlannedStageOut(BaseModel):
    """A stage that a job would have."""

    name: str
    title: str
    hash: str = Field(description="address of its outputs: they depend on nothing else")
    requires: list[str]
    would: Literal["run", "reuse"] = Field(description="`reuse`: the outputs are there already")

    @classmethod
    def of(cls, planned: PlannedStage, *, reuse: bool) -> PlannedStageOut:
        return cls(
            name=planned.name,
            title=STAGES[planned.name].title,
            hash=planned.hash,
            requires=list(planned.requires),
            would="reuse" if reuse else "run",
        )


class ErrorOut(BaseModel):
    """Why a stage failed."""

    code: str = Field(examples=["no_overlap"])
    message: str
    hint: str
    details: dict[str, JsonValue]


class StageOut(BaseModel):
    """A stage of a job."""

    name: str = Field(examples=["sync"])
    title: str = Field(examples=["Synchronise the cameras"])
    requires: list[str] = Field(description="stages that it waits for")
    state: StageState
    fraction: float = Field(ge=0, le=1)
    message: str
    figures: dict[str, float | None] = Field(description="the latest figures, e.g. a loss")
    summary: dict[str, JsonValue] | None = Field(description="what it says about its result")
    warnings: list[StageWarning] = Field(description="what makes its result doubtful, and what to do about it")
    error: ErrorOut | None
    attempts: int
    hash: str
    started_at: datetime | None
    finished_at: datetime | None
    seconds: float | None = Field(description="how long it took")
    remaining_s: float | None = Field(description="how long it will still take once it runs, where enough is known")

    @classmethod
    def of(cls, stage: StageRun, pace: Pace, now: float) -> StageOut:
        both = stage.started_at is not None and stage.finished_at is not None
        return cls(
            name=stage.name,
            title=STAGES[stage.name].title if stage.name in STAGES else stage.name,
            requires=list(stage.requires),
            state=stage.state,
            fraction=stage.fraction,
            message=stage.message,
            figures=dict(stage.figures or {}),
            summary=None if stage.summary is None else dict(stage.summary),
            warnings=list(stage.warnings),
            error=None if stage.error is None else ErrorOut.model_validate(stage.error),
            attempts=stage.attempts,
            hash=stage.hash,
            started_at=_time_or_none(stage.started_at),
            finished_at=_time_or_none(stage.finished_at),
            seconds=(stage.finished_at or 0.0) - (stage.started_at or 0.0) if both else None,
            remaining_s=stage_remaining_s(stage, pace, now),
        )


class JobOut(BaseModel):
    """A job: one run of the pipeline on a site."""

    id: str = Field(examples=["job_5e4d3c2b1a098765"])
    site_id: str
    site_name: str = Field(description="as it was when the job was created")
    name: str = Field(description="what its user calls it; may be empty")
    tags: list[str] = Field(description="words of its users, sorted", examples=[["rain"]])
    kind: JobKind = Field(description="`training`, or `run`: a network that is there on new footage")
    model_id: str | None = Field(description="the network that a run uses")
    continues: str | None = Field(description="the run whose road users this run follows on")
    state: JobState
    is_terminal: bool = Field(description="nothing happens any more unless the job is restarted")
    fraction: float = Field(ge=0, le=1, description="done, weighted by how long stages are expected to take")
    remaining_s: float | None = Field(description="how long it will still take, where enough is known")
    options: dict[str, dict[str, JsonValue]]
    files: list[RecordingOut]
    stages: list[StageOut] = Field(description="in the order of the pipeline")
    error: ErrorOut | None = Field(description="why it failed; `details.stage` names the stage")
    restarts: int
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None

    @classmethod
    def of(cls, job: Job, now: float) -> JobOut:
        pace = pace_of(job, this_machine())
        return cls(
            id=job.id,
            site_id=job.site_id,
            site_name=job.site.name,
            name=job.name,
            tags=list(job.tags),
            kind=job.kind,
            model_id=job.model_id,
            continues=job.continues,
            state=job.state,
            is_terminal=job.state.is_terminal,
            fraction=job_fraction(job, pace),
            remaining_s=remaining_s(job, pace, now),
            options=dict(job.options),
            files=[RecordingOut.of(file) for file in job.files],
            stages=[StageOut.of(stage, pace, now) for stage in job.stages],
            error=None if job.error is None else ErrorOut.model_validate(job.error),
            restarts=job.restarts,
            created_at=_time(job.created_at),
            started_at=_time_or_none(job.started_at),
            finished_at=_time_or_none(job.finished_at),
        )


class EventOut(BaseModel):
    """Something that happened to a job."""

    sequence: int = Field(
        description="rises from 1; also the id of the server-sent event. Numbers may be missing: once a stage has "
        "ended, the last report of its progress alone is kept"
    )
    kind: Literal["job", "stage", "progress"]
    at: datetime
    data: dict[str, JsonValue]

    @classmethod
    def of(cls, event: Event) -> EventOut:
        return cls(sequence=event.sequence, kind=event.kind.value, at=_time(event.at), data=dict(event.data))


class LogOut(BaseModel):
    """A part of a job's log."""

    text: str
    next_offset: int = Field(description="ask for this offset next")
    complete: bool = Field(description="the job has ended, and this was the last part")


class ArtifactOut(BaseModel):
    """A file that a stage wrote."""

    id: str = Field(examples=["evaluate/metrics.json"])
    artifact: str = Field(description="what it is, or is a part of", examples=["metrics"])
    title: str = Field(examples=["How good the networks are"])
    stage: str
    name: str
    media_type: str = Field(examples=["application/json"])
    version: int = Field(description="of the artifact's layout")
    size_bytes: int
    sha256: str

    @classmethod
    def of(cls, file: ResultFile) -> ArtifactOut:
        return cls(
            id=file.id,
            artifact=file.artifact.name,
            title=file.artifact.title,
            stage=file.stage,
            name=file.name,
            media_type=file.artifact.codec.media_type,
            version=file.artifact.version,
            size_bytes=file.size_bytes,
            sha256=file.sha256,
        )


class ReportLinkOut(BaseModel):
    """A link that opens the report in a browser without a token."""

    url: str = Field(examples=["/reports/job_5e4d3c2b1a098765?expires=1700000000&signature=..."])
    expires_at: datetime


class ShareLinkIn(BaseModel):
    """A link to a job to make."""

    model_config = ConfigDict(extra="forbid")

    lifetime_h: float = Field(168.0, gt=0, le=24 * 366, description="how long it works")


class ShareLinkOut(BaseModel):
    """A link that lets a browser read a job and its results without a token, and change nothing."""

    url: str = Field(examples=["/share/job_5e4d3c2b1a098765?key=..."])
    expires_at: datetime


class OptionsOut(BaseModel):
    """All options of a job."""

    defaults: PipelineConfig
    json_schema: dict[str, JsonValue] = Field(alias="schema", description="their meaning and limits as JSON Schema")


class VersionOut(BaseModel):
    version: str
    stages: list[str]


class HealthOut(BaseModel):
    status: Literal["ok"] = "ok"
