"""Rows to records."""

from __future__ import annotations

import math
import secrets
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

from sqlalchemy import Row

from wibam_core.adapters.models import EventRow, FileRow, JobRow, SiteRow, StageRow, TrainedModelRow, UploadRow
from wibam_core.documents.trained_model import ModelDocument
from wibam_core.documents.warnings import StageWarning
from wibam_core.job_kind import JobKind
from wibam_core.jobs.records import (
    Event,
    EventKind,
    Job,
    ModelState,
    Purpose,
    SiteRecord,
    StageRun,
    StoredFile,
    TrainedModel,
    Upload,
)
from wibam_core.jobs.states import JobState, StageState
from wibam_core.site import Site


def new_id(kind: str) -> str:
    """A fresh id, e.g. ``job_3f0c9a1be2d44c70``. Plain enough to be a file name."""
    return f"{kind}_{secrets.token_hex(8)}"


def plain_text(text: str) -> str:
    """Text that every database takes: without NUL bytes and lone surrogates."""
    return text.replace("\0", "").encode("utf-8", "replace").decode("utf-8")


def plain_json(value: Any) -> Any:
    """JSON that every database takes: non-finite numbers become null, text is made plain."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str):
        return plain_text(value)
    if isinstance(value, Mapping):
        return {plain_text(str(key)): plain_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(item) for item in value]
    return value


@lru_cache(maxsize=256)
def _site(document: str) -> Site:
    """A site, which nothing changes: the jobs of a list are mostly of a few sites."""
    return Site.model_validate_json(document)


def site_record(row: SiteRow) -> SiteRecord:
    return SiteRecord(row.id, _site(row.document), row.created_at)


def stored_file(row: FileRow) -> StoredFile:
    return StoredFile(
        id=row.id,
        site_id=row.site_id,
        purpose=Purpose(row.purpose),
        camera_id=row.camera_id,
        filename=row.filename,
        suffix=row.suffix,
        size_bytes=row.size_bytes,
        sha256=row.sha256,
        created_at=row.created_at,
        started_ns=row.started_ns,
    )


def upload(row: UploadRow) -> Upload:
    return Upload(
        id=row.id,
        site_id=row.site_id,
        purpose=Purpose(row.purpose),
        camera_id=row.camera_id,
        filename=row.filename,
        length=row.length_bytes,
        offset=row.offset_bytes,
        created_at=row.created_at,
        expires_at=row.expires_at,
        file_id=row.file_id,
        started_ns=row.started_ns,
    )


def stage_run(row: StageRow | Row[Any]) -> StageRun:
    return StageRun(
        job_id=row.job_id,
        name=row.name,
        hash=row.hash,
        requires=tuple(row.requires),
        frame_hash=row.frame_hash,
        state=StageState(row.state),
        forced=row.forced,
        attempts=row.attempts,
        fence=row.fence,
        lease_owner=row.lease_owner,
        lease_expires_at=row.lease_expires_at,
        fraction=row.fraction,
        message=row.message,
        figures=row.figures,
        summary=row.summary,
        warnings=tuple(StageWarning.model_validate(warning) for warning in row.warnings or ()),
        error=row.error,
        started_at=row.started_at,
        finished_at=row.finished_at,
    )


def job(row: JobRow, files: Iterable[StoredFile], stages: Iterable[StageRow | Row[Any]], tags: Iterable[str]) -> Job:
    return Job(
        id=row.id,
        site_id=row.site_id,
        site=_site(row.site_document),
        options=row.options,
        files=tuple(files),
        stages=tuple(stage_run(stage) for stage in stages),
        state=JobState(row.state),
        created_at=row.created_at,
        started_at=row.started_at,
        finished_at=row.finished_at,
        error=row.error,
        restarts=row.restarts,
        name=row.name,
        tags=tuple(tags),
        kind=JobKind(row.kind),
        model_id=row.model_id,
        continues=row.continues,
    )


def trained_model(row: TrainedModelRow) -> TrainedModel:
    return TrainedModel(
        id=row.id,
        name=row.name,
        site_id=row.site_id,
        version=row.version,
        state=ModelState(row.state),
        job_id=row.job_id,
        sha256=row.sha256,
        size_bytes=row.size_bytes,
        has_onnx=row.has_onnx,
        has_usual=row.has_usual,
        document=ModelDocument.model_validate_json(row.document),
        created_at=row.created_at,
    )


def event(row: EventRow) -> Event:
    return Event(row.job_id, row.sequence, EventKind(row.kind), row.at, row.data)
