"""What the service says, as the client hands it on. Fields that a newer service adds are left out."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict

from wibam_core.documents.clips import ClipFacts, ClipSpec
from wibam_core.documents.trained_model import ModelDocument
from wibam_core.documents.warnings import StageWarning
from wibam_core.errors import WibamError
from wibam_core.jobs.clips import ClipState
from wibam_core.jobs.records import ModelState, Purpose
from wibam_core.jobs.states import JobState, StageState
from wibam_core.jobs.webhooks import DeliveryState, WebhookEvent


class _View(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class SiteView(_View):
    """A site as the service has it."""

    id: str
    name: str
    cameras: tuple[str, ...]


class FileView(_View):
    """An uploaded file of a site."""

    id: str
    purpose: Purpose
    camera: str | None
    filename: str
    size_bytes: int
    sha256: str


class ModelView(_View):
    """A network that the service keeps."""

    id: str
    name: str
    site_id: str
    version: int
    state: ModelState
    job_id: str | None
    sha256: str
    size_bytes: int
    has_onnx: bool
    created_at: str
    about: ModelDocument


class FootageView(_View):
    """Footage of a camera that networks can be run on."""

    id: str
    camera: str
    filename: str
    size_bytes: int
    started_at: str | None


class ProblemView(_View):
    """Why something failed."""

    code: str
    message: str
    hint: str = ""
    details: dict[str, Any] = {}


class StageView(_View):
    """A stage of a job."""

    name: str
    title: str
    state: StageState
    fraction: float
    message: str
    figures: dict[str, float | None] = {}
    summary: dict[str, Any] | None = None
    warnings: tuple[StageWarning, ...] = ()
    error: ProblemView | None = None
    seconds: float | None = None
    remaining_s: float | None = None


class JobView(_View):
    """A job as it stands."""

    id: str
    site_id: str
    name: str = ""
    tags: tuple[str, ...] = ()
    state: JobState
    fraction: float
    remaining_s: float | None
    stages: tuple[StageView, ...]
    error: ProblemView | None = None
    created_at: str

    def raise_for_failure(self) -> None:
        """Raises:
        WibamError: of the kind that made the job fail.
        """
        if self.state is JobState.FAILED and self.error is not None:
            raise WibamError.from_dict(self.error.model_dump())


class PlannedView(_View):
    """What a job would do with a stage: ``would`` is "run" or "reuse"."""

    name: str
    title: str
    would: str


class ArtifactView(_View):
    """A file that a stage wrote."""

    id: str
    artifact: str
    title: str
    size_bytes: int
    sha256: str


class ClipView(_View):
    """A video clip as it stands."""

    id: str
    spec: ClipSpec
    state: ClipState
    fraction: float
    message: str
    error: ProblemView | None = None
    facts: ClipFacts | None = None
    size_bytes: int | None = None
    outdated: bool = False

    def raise_for_failure(self) -> None:
        """Raises:
        WibamError: of the kind that made it fail.
        """
        if self.state is ClipState.FAILED and self.error is not None:
            raise WibamError.from_dict(self.error.model_dump())


class KeyView(_View):
    """An API key, without its secret."""

    id: str
    name: str
    scopes: tuple[str, ...]
    created_at: str
    expires_at: str | None
    last_used_at: str | None
    works: bool


class NewKeyView(KeyView):
    """A key that was just made, with its secret."""

    secret: str


class WebhookView(_View):
    """Who is told of what."""

    id: str
    name: str
    url: str
    site_id: str | None
    job_id: str | None
    events: tuple[WebhookEvent, ...]
    active: bool


class NewWebhookView(WebhookView):
    """A webhook that was just made, with the secret of its signatures."""

    secret: str


class AttemptView(_View):
    """One try at sending; without a status there was no answer."""

    at: str
    status: int | None
    error: str
    seconds: float


class DeliveryView(_View):
    """Something that a webhook was, or is to be, told."""

    id: str
    event: WebhookEvent
    state: DeliveryState
    body: str
    attempts: tuple[AttemptView, ...]
    next_at: str | None
    created_at: str


class AuditView(_View):
    """A change that somebody made, or tried to."""

    id: int
    at: str
    who: str
    what: str
    status: int
    request_id: str
