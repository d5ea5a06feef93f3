"""What the service remembers: sites, files, uploads, jobs, their stages and events. Times are Unix seconds (UTC)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from hashlib import sha256
from typing import Any

from wibam_core.documents.trained_model import ModelDocument
from wibam_core.documents.warnings import StageWarning
from wibam_core.job_kind import JobKind
from wibam_core.jobs.machine import StageNode
from wibam_core.jobs.states import JobState, StageState
from wibam_core.site import Site


class Purpose(StrEnum):
    """What an uploaded file is for. Recordings and footage belong to a camera; the others to the site.

    A camera has one recording, which jobs learn from, and any amount of footage, which networks are run on.
    """

    RECORDING = "recording"
    FOOTAGE = "footage"
    LABELS = "labels"
    DETECTOR = "detector"
    NETWORK = "network"
    MODEL = "model"
    MAP = "map"

    @property
    def is_of_camera(self) -> bool:
        return self in (Purpose.RECORDING, Purpose.FOOTAGE)


@dataclass(frozen=True)
class SiteRecord:
    """A site as it was described."""

    id: str
    site: Site
    created_at: float

    @property
    def version(self) -> str:
        """Of the description: another one has another version, and the same one the same."""
        return sha256(self.site.model_dump_json().encode()).hexdigest()[:32]


@dataclass(frozen=True)
class StoredFile:
    """A complete uploaded file.

    Attributes:
        camera_id: of a recording; empty otherwise.
        filename: as the client called it. It tells the files of one recording apart, and is never part of a path.
        suffix: what kind of file it is, found by looking at it (".parquet", ".json" or "").
        started_ns: when its first frame was taken, Unix time; None: nobody said.
    """

    id: str
    site_id: str
    purpose: Purpose
    camera_id: str
    filename: str
    suffix: str
    size_bytes: int
    sha256: str
    created_at: float
    started_ns: int | None = None

    def __post_init__(self) -> None:
        if self.purpose.is_of_camera != bool(self.camera_id):
            raise ValueError("recordings and footage, and only these, belong to a camera")


def recordings_of(files: Iterable[StoredFile]) -> dict[str, tuple[StoredFile, ...]]:
    """Camera id -> the file, or files, of its recording or footage, by name."""
    found: dict[str, tuple[StoredFile, ...]] = {}
    for file in sorted(files, key=lambda file: file.filename):
        if file.purpose.is_of_camera:
            found[file.camera_id] = (*found.get(file.camera_id, ()), file)
    return found


@dataclass(frozen=True)
class Upload:
    """A resumable upload. ``offset`` bytes are safely on disk; it is complete when ``file_id`` is set."""

    id: str
    site_id: str
    purpose: Purpose
    camera_id: str
    filename: str
    length: int
    offset: int
    created_at: float
    expires_at: float
    file_id: str | None = None
    started_ns: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.offset <= self.length:
            raise ValueError(f"offset must be in [0, {self.length}], got {self.offset}")


@dataclass(frozen=True)
class StageRun:
    """One stage of one job.

    Attributes:
        hash: address of its outputs; equal hashes have equal outputs.
        frame_hash: outputs with equal ones hold the same of each frame; None where it does not work frame by frame.
        forced: runs even if its outputs are published already.
        attempts: how often a worker has claimed it since the job was (re)started.
        fence: raised by every claim; see `wibam_core.jobs.leases`.
        fraction, message, figures: the latest progress.
        summary: what the stage says about its result. error: a `WibamError.to_dict`.
        warnings: what makes its result doubtful, also where it failed.
    """

    job_id: str
    name: str
    hash: str
    requires: tuple[str, ...]
    state: StageState
    frame_hash: str | None = None
    forced: bool = False
    attempts: int = 0
    fence: int = 0
    lease_owner: str | None = None
    lease_expires_at: float | None = None
    fraction: float = 0.0
    message: str = ""
    figures: Mapping[str, float] | None = None
    summary: Mapping[str, Any] | None = None
    warnings: tuple[StageWarning, ...] = ()
    error: Mapping[str, Any] | None = None
    started_at: float | None = None
    finished_at: float | None = None

    @property
    def node(self) -> StageNode:
        return StageNode(self.name, self.state, self.requires)


@dataclass(frozen=True)
class Job:
    """A run of the pipeline on a site as it was when the job was created.

    Attributes:
        options: as given; `PipelineConfig.parse` reads them.
        files: the uploaded files it works on.
        error: why it failed: a `WibamError.to_dict` with the stage's name in its details.
        restarts: how often it was restarted.
        name: what users call it; may be empty.
        tags: words of its users by which it is found again, sorted.
        kind: what it is for.
        model_id: the network that a run uses.
        continues: the run whose road users a run follows on.
    """

    id: str
    site_id: str
    site: Site
    options: Mapping[str, Any]
    files: tuple[StoredFile, ...]
    stages: tuple[StageRun, ...]
    state: JobState
    created_at: float
    started_at: float | None = None
    finished_at: float | None = None
    error: Mapping[str, Any] | None = None
    restarts: int = 0
    name: str = ""
    tags: tuple[str, ...] = ()
    kind: JobKind = JobKind.TRAINING
    model_id: str | None = None
    continues: str | None = None

    def stage(self, name: str) -> StageRun | None:
        """The stage of this name, if the job has one."""
        return next((stage for stage in self.stages if stage.name == name), None)

    @property
    def recordings(self) -> dict[str, tuple[StoredFile, ...]]:
        """Camera id -> the file, or files, of its recording."""
        return recordings_of(self.files)

    @property
    def assets(self) -> dict[str, StoredFile]:
        """ "labels", "detector", "network" -> file."""
        return {file.purpose.value: file for file in self.files if not file.purpose.is_of_camera}


class ModelState(StrEnum):
    """Of a site's networks one at most is promoted: the one to use. Retired ones are kept for the record."""

    CANDIDATE = "candidate"
    PROMOTED = "promoted"
    RETIRED = "retired"


@dataclass(frozen=True)
class TrainedModel:
    """A network that the service keeps.

    Attributes:
        version: counts the networks of a site, from 1.
        job_id: that made it; None: it was uploaded.
        has_onnx: there is an ONNX file of it, too. has_usual: what was usual where it was made is kept with it.
    """

    id: str
    name: str
    site_id: str
    version: int
    state: ModelState
    job_id: str | None
    sha256: str
    size_bytes: int
    has_onnx: bool
    has_usual: bool
    document: ModelDocument
    created_at: float


class EventKind(StrEnum):
    """``JOB`` and ``STAGE`` tell a change of state, ``PROGRESS`` how far a running stage is."""

    JOB = "job"
    STAGE = "stage"
    PROGRESS = "progress"


@dataclass(frozen=True)
class Event:
    """Something that happened to a job. ``sequence`` counts them within the job, from 1.

    Numbers may be missing: once a stage has ended, the last report of its progress alone is kept.
    """

    job_id: str
    sequence: int
    kind: EventKind
    at: float
    data: Mapping[str, Any]
