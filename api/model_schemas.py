"""What the API says of networks and footage."""

from __future__ import annotations

from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from api.schemas import Id, JobName, Tags
from api.times import to_time
from wibam_core.documents.trained_model import ModelDocument
from wibam_core.jobs.records import ModelState, StoredFile, TrainedModel


class ModelOut(BaseModel):
    """A network that the service keeps."""

    id: str = Field(examples=["model_1f2e3d4c5b6a7988"])
    name: str
    site_id: str = Field(description="whose it is; the site may be gone")
    version: int = Field(description="counts the networks of a site, from 1")
    state: ModelState = Field(description="of a site's networks one at most is promoted: the one to use")
    job_id: str | None = Field(description="that made it; null: it was uploaded")
    sha256: str = Field(description="of the safetensors file")
    size_bytes: int
    has_onnx: bool
    watches: bool = Field(description="runs can tell whether a camera was turned, and whether the network sees worse")
    created_at: datetime
    about: ModelDocument

    @classmethod
    def of(cls, model: TrainedModel) -> ModelOut:
        return cls(
            id=model.id,
            name=model.name,
            site_id=model.site_id,
            version=model.version,
            state=model.state,
            job_id=model.job_id,
            sha256=model.sha256,
            size_bytes=model.size_bytes,
            has_onnx=model.has_onnx,
            watches=model.has_usual,
            created_at=to_time(round(model.created_at * 1e9)),
            about=model.document,
        )


class ModelIn(BaseModel):
    """A network to keep: uploaded to a site with the purpose `model`, or made by a job."""

    model_config = ConfigDict(extra="forbid")

    site_id: Id | None = Field(None, description="of an upload")
    file_id: Id | None = Field(None, description="of the upload")
    job_id: Id | None = Field(None, description="whose network to keep at once; it is kept by itself before long")
    name: JobName = ""


class ModelChangeIn(BaseModel):
    """What of a network can be changed; what is left out stays."""

    model_config = ConfigDict(extra="forbid")

    name: JobName | None = None
    state: ModelState | None = Field(None, description="`promoted` makes the one that was a candidate")


class RunIn(BaseModel):
    """A network to run on footage."""

    model_config = ConfigDict(extra="forbid")

    files: list[Id] = Field(
        min_length=1, max_length=1000, description="ids of footage or recordings, of one camera or several"
    )
    site_id: Id | None = Field(None, description="whose footage; left out: the network's own site")
    continues: Id | None = Field(
        None, description="the run before, of the same cameras: whoever is in view at the joint keeps their id"
    )
    name: JobName = ""
    tags: Tags = []
    options: dict[str, JsonValue] = Field(
        {},
        description="options of the stages preflight, calibrate, sync, track and safety",
        examples=[{"track": {"rate_hz": 5}}],
    )


class FootageOut(BaseModel):
    """Footage of a camera that networks can be run on."""

    id: str = Field(examples=["file_9b8a7c6d5e4f3a2b"])
    site_id: str
    camera: str
    filename: str
    size_bytes: int
    sha256: str
    is_recording: bool = Field(description="jobs learn from it, too")
    started_at: datetime | None = Field(description="when its first frame was taken; null: nobody said")
    created_at: datetime

    @classmethod
    def of(cls, file: StoredFile) -> FootageOut:
        return cls(
            id=file.id,
            site_id=file.site_id,
            camera=file.camera_id,
            filename=file.filename,
            size_bytes=file.size_bytes,
            sha256=file.sha256,
            is_recording=file.purpose.value == "recording",
            started_at=None if file.started_ns is None else to_time(file.started_ns),
            created_at=to_time(round(file.created_at * 1e9)),
        )


class FootageChangeIn(BaseModel):
    """What of footage can be changed: when it began."""

    model_config = ConfigDict(extra="forbid")

    started_at: str | None = Field(
        max_length=60,
        description="when the first frame was taken: ISO 8601 with its offset from UTC; null: unknown",
        examples=["2026-07-01T08:00:00+02:00"],
    )
