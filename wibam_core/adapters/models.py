"""The tables. Times are Unix seconds; documents are JSON; ids are made by the service."""

from __future__ import annotations

from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Float,
    ForeignKey,
    Index,
    LargeBinary,
    MetaData,
    String,
    Text,
    UniqueConstraint,
    text,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

_NAMING = {
    "ix": "ix_%(column_0_N_label)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "ck": "ck_%(table_name)s_%(constraint_name)s",
    "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
    "pk": "pk_%(table_name)s",
}


class Base(DeclarativeBase):
    metadata = MetaData(naming_convention=_NAMING)
    type_annotation_map = {  # noqa: RUF012  # SQLAlchemy's name
        float: Float(53),
        dict[str, Any]: JSON,
        list[str]: JSON,
        list[dict[str, Any]]: JSON,
    }


class DatabaseIdRow(Base):
    """The one row that tells this database from every other, and which data folder is its own."""

    __tablename__ = "database_id"

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    folder_id: Mapped[str | None] = mapped_column(String(64))


class ApiKeyRow(Base):
    """``digest``: SHA-256 of the secret; the secret itself is not kept."""

    __tablename__ = "api_keys"

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    name: Mapped[str] = mapped_column(String(200))
    scopes: Mapped[list[str]]
    digest: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[float]
    expires_at: Mapped[float | None]
    last_used_at: Mapped[float | None]
    revoked_at: Mapped[float | None]

    __table_args__ = (Index("ix_api_keys_digest", "digest", unique=True),)


class AuditRow(Base):
    """One change that somebody made, or tried to."""

    __tablename__ = "audit"

    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    at: Mapped[float] = mapped_column(index=True)
    who: Mapped[str] = mapped_column(String(80))
    what: Mapped[str] = mapped_column(String(500))
    status: Mapped[int]
    request_id: Mapped[str] = mapped_column(String(64))
    address: Mapped[str] = mapped_column(String(80))


class SiteRow(Base):
    __tablename__ = "sites"

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    document: Mapped[str] = mapped_column(Text)
    created_at: Mapped[float]


class FileRow(Base):
    """``retired_at``: replaced or deleted; the bytes stay for as long as an unfinished job works on them."""

    __tablename__ = "files"
    __table_args__ = (
        Index(
            "uq_files_current",
            "site_id",
            "purpose",
            "camera_id",
            "filename",
            unique=True,
            sqlite_where=text("retired_at IS NULL"),
            postgresql_where=text("retired_at IS NULL"),
        ),
    )

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    site_id: Mapped[str] = mapped_column(ForeignKey("sites.id", ondelete="CASCADE"), index=True)
    purpose: Mapped[str] = mapped_column(String(16))
    camera_id: Mapped[str] = mapped_column(String(64))
    filename: Mapped[str] = mapped_column(String(255))
    suffix: Mapped[str] = mapped_column(String(16))
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    sha256: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[float]
    retired_at: Mapped[float | None]
    started_ns: Mapped[int | None] = mapped_column(BigInteger)


class UploadRow(Base):
    """``offset_bytes`` are safely on disk; ``given_metadata`` is the client's, word by word."""

    __tablename__ = "uploads"

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    site_id: Mapped[str] = mapped_column(ForeignKey("sites.id", ondelete="CASCADE"), index=True)
    purpose: Mapped[str] = mapped_column(String(16))
    camera_id: Mapped[str] = mapped_column(String(64))
    filename: Mapped[str] = mapped_column(String(255))
    length_bytes: Mapped[int] = mapped_column(BigInteger)
    offset_bytes: Mapped[int] = mapped_column(BigInteger)
    created_at: Mapped[float]
    expires_at: Mapped[float] = mapped_column(index=True)
    file_id: Mapped[str | None] = mapped_column(String(64))
    given_metadata: Mapped[str] = mapped_column(Text)
    started_ns: Mapped[int | None] = mapped_column(BigInteger)


class JobRow(Base):
    """``last_event`` counts the job's events; raising it is also what locks a job against concurrent changes."""

    __tablename__ = "jobs"
    __table_args__ = (Index("uq_jobs_idempotency", "site_id", "idempotency_key", unique=True),)

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    site_id: Mapped[str] = mapped_column(ForeignKey("sites.id", ondelete="CASCADE"), index=True)
    site_document: Mapped[str] = mapped_column(Text)
    options: Mapped[dict[str, Any]]
    state: Mapped[str] = mapped_column(String(16), index=True)
    created_at: Mapped[float] = mapped_column(index=True)
    started_at: Mapped[float | None]
    finished_at: Mapped[float | None]
    error: Mapped[dict[str, Any] | None]
    restarts: Mapped[int]
    last_event: Mapped[int]
    idempotency_key: Mapped[str | None] = mapped_column(String(255))
    name: Mapped[str] = mapped_column(String(200), server_default="")
    kind: Mapped[str] = mapped_column(String(16), server_default="training")
    model_id: Mapped[str | None] = mapped_column(String(64))
    continues: Mapped[str | None] = mapped_column(String(64))


class JobTagRow(Base):
    __tablename__ = "job_tags"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    tag: Mapped[str] = mapped_column(String(64), primary_key=True, index=True)


class JobFileRow(Base):
    __tablename__ = "job_files"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    file_id: Mapped[str] = mapped_column(ForeignKey("files.id", ondelete="CASCADE"), primary_key=True, index=True)


class StageRow(Base):
    """Of the runs that share a hash only one runs at a time: they share a scratch folder."""

    __tablename__ = "stage_runs"
    __table_args__ = (
        Index(
            "uq_stage_runs_running_hash",
            "hash",
            unique=True,
            sqlite_where=text("state = 'running'"),
            postgresql_where=text("state = 'running'"),
        ),
        Index("ix_stage_runs_state", "state", "lease_expires_at"),
    )

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    position: Mapped[int]
    hash: Mapped[str] = mapped_column(String(64), index=True)
    requires: Mapped[list[str]]
    frame_hash: Mapped[str | None] = mapped_column(String(64))
    state: Mapped[str] = mapped_column(String(16))
    forced: Mapped[bool]
    attempts: Mapped[int]
    fence: Mapped[int]
    lease_owner: Mapped[str | None] = mapped_column(String(255))
    lease_expires_at: Mapped[float | None]
    dispatched_at: Mapped[float | None]
    fraction: Mapped[float]
    message: Mapped[str] = mapped_column(Text)
    figures: Mapped[dict[str, Any] | None]
    summary: Mapped[dict[str, Any] | None]
    warnings: Mapped[list[dict[str, Any]] | None]
    error: Mapped[dict[str, Any] | None]
    started_at: Mapped[float | None]
    finished_at: Mapped[float | None]


class ConflictReviewRow(Base):
    """What somebody said of a conflict in the outputs of a safety stage; ``hash`` is their address."""

    __tablename__ = "conflict_reviews"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    hash: Mapped[str] = mapped_column(String(64), primary_key=True)
    conflict_id: Mapped[int] = mapped_column(primary_key=True)
    verdict: Mapped[str] = mapped_column(String(16))
    note: Mapped[str] = mapped_column(Text)
    reviewed_at: Mapped[float]


class LabelVersionRow(Base):
    """Hand labels of one instant as somebody saved them. They belong to the site and its footage, not to a job.

    ``footage`` is the digest of the reference camera's recording, on whose clock the times are.
    """

    __tablename__ = "label_versions"

    site_id: Mapped[str] = mapped_column(ForeignKey("sites.id", ondelete="CASCADE"), primary_key=True)
    footage: Mapped[str] = mapped_column(String(64), primary_key=True)
    label_set: Mapped[str] = mapped_column(String(64), primary_key=True)
    time_ns: Mapped[int] = mapped_column(BigInteger, primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    document: Mapped[str] = mapped_column(Text)
    author: Mapped[str] = mapped_column(String(100))
    saved_at: Mapped[float]


class SiteMapRow(Base):
    """A picture of the site from above: a JPEG of ours, and a `SiteMap`."""

    __tablename__ = "site_maps"

    site_id: Mapped[str] = mapped_column(ForeignKey("sites.id", ondelete="CASCADE"), primary_key=True)
    document: Mapped[str] = mapped_column(Text)
    picture: Mapped[bytes] = mapped_column(LargeBinary, deferred=True)
    saved_at: Mapped[float]


class ClipRow(Base):
    """A video clip of a job's results; ``tracks_hash`` is the address of the outputs whose tracks it shows."""

    __tablename__ = "clips"
    __table_args__ = (Index("ix_clips_state", "state", "lease_expires_at"),)

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), index=True)
    spec: Mapped[dict[str, Any]]
    tracks_hash: Mapped[str] = mapped_column(String(64))
    state: Mapped[str] = mapped_column(String(16))
    attempts: Mapped[int]
    fence: Mapped[int]
    lease_owner: Mapped[str | None] = mapped_column(String(255))
    lease_expires_at: Mapped[float | None]
    dispatched_at: Mapped[float | None]
    fraction: Mapped[float]
    message: Mapped[str] = mapped_column(Text)
    error: Mapped[dict[str, Any] | None]
    facts: Mapped[dict[str, Any] | None]
    size_bytes: Mapped[int | None] = mapped_column(BigInteger)
    created_at: Mapped[float]
    finished_at: Mapped[float | None]


class TrainedModelRow(Base):
    """A network that is kept, whatever becomes of the job that made it, or of its site.

    ``stage_hash`` is the address of the outputs of fine-tuning; ``version`` counts the networks of a site. That of a
    job which was deleted stays as a row with the state "deleted".
    """

    __tablename__ = "trained_models"
    __table_args__ = (UniqueConstraint("site_id", "version"), UniqueConstraint("job_id", "stage_hash"))

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    name: Mapped[str] = mapped_column(String(200))
    site_id: Mapped[str] = mapped_column(String(64))
    version: Mapped[int]
    state: Mapped[str] = mapped_column(String(16))
    job_id: Mapped[str | None] = mapped_column(String(64))
    stage_hash: Mapped[str | None] = mapped_column(String(64))
    sha256: Mapped[str] = mapped_column(String(64), index=True)
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    has_onnx: Mapped[bool]
    has_usual: Mapped[bool]
    document: Mapped[str] = mapped_column(Text)
    created_at: Mapped[float]


class SiteTracksRow(Base):
    """The tracks of a run or job that are whole in its site's table; ``stage_hash`` is the address that they come from.

    Where it is not known when the footage began there are no states.
    """

    __tablename__ = "site_tracks"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    site_id: Mapped[str] = mapped_column(String(64), index=True)
    stage_hash: Mapped[str] = mapped_column(String(64))
    first_run_id: Mapped[str] = mapped_column(String(64))
    model_id: Mapped[str | None] = mapped_column(String(64))
    cameras: Mapped[list[str]]
    start_ns: Mapped[int] = mapped_column(BigInteger)
    end_ns: Mapped[int] = mapped_column(BigInteger)
    states: Mapped[int] = mapped_column(BigInteger)


class CounterRow(Base):
    """What was counted since the service was set up; it outlives the jobs. ``stage`` and ``outcome`` may be empty."""

    __tablename__ = "counters"

    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    stage: Mapped[str] = mapped_column(String(64), primary_key=True)
    outcome: Mapped[str] = mapped_column(String(16), primary_key=True)
    value: Mapped[float]


class WebhookRow(Base):
    """Of a site's jobs, of one job's, or of all; it outlives what it is of until everything is told."""

    __tablename__ = "webhooks"

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    name: Mapped[str] = mapped_column(String(200))
    url: Mapped[str] = mapped_column(String(2000))
    site_id: Mapped[str | None] = mapped_column(String(64))
    job_id: Mapped[str | None] = mapped_column(String(64))
    events: Mapped[list[str]]
    secret: Mapped[str] = mapped_column(String(80))
    active: Mapped[bool]
    created_at: Mapped[float]


class DeliveryRow(Base):
    """Something that a webhook is told; ``claims`` counts the senders that have taken it."""

    __tablename__ = "webhook_deliveries"
    __table_args__ = (
        Index("ix_webhook_deliveries_due", "state", "next_at"),
        Index("ix_webhook_deliveries_of", "webhook_id", "created_at"),
    )

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    webhook_id: Mapped[str] = mapped_column(ForeignKey("webhooks.id", ondelete="CASCADE"))
    event: Mapped[str] = mapped_column(String(32))
    body: Mapped[str] = mapped_column(Text)
    state: Mapped[str] = mapped_column(String(16))
    attempts: Mapped[list[dict[str, Any]]]
    claims: Mapped[int]
    next_at: Mapped[float | None]
    created_at: Mapped[float]


class EventRow(Base):
    __tablename__ = "events"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    sequence: Mapped[int] = mapped_column(primary_key=True)
    kind: Mapped[str] = mapped_column(String(16))
    at: Mapped[float]
    data: Mapped[dict[str, Any]]
