"""`WibamClient`: what one can ask a service, with types."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import quote

from wibam_core.client.clips import ClipRequests
from wibam_core.client.connection import Connection
from wibam_core.client.labels import LabelRequests
from wibam_core.client.networks import NetworkRequests
from wibam_core.client.results import ResultRequests
from wibam_core.client.uploading import UploadProgress
from wibam_core.client.views import (
    AuditView,
    FileView,
    JobView,
    KeyView,
    NewKeyView,
    PlannedView,
    SiteView,
)
from wibam_core.client.webhooks import WebhookRequests
from wibam_core.errors import ServiceUnavailable
from wibam_core.job_kind import JobKind
from wibam_core.jobs.records import Purpose
from wibam_core.jobs.states import JobState
from wibam_core.site import Site


class WibamClient(NetworkRequests, ResultRequests, LabelRequests, ClipRequests, WebhookRequests):
    """Talks to one service. A context manager. Errors of the service come back as `WibamError`s of the same kind.

    Args:
        url: e.g. ``http://127.0.0.1:8000``.
        token: the API token.
        timeout_s: for one request without news.
        patience_s: how long uploads and `wait` put up with a service that does not answer.
    """

    def __init__(self, url: str, token: str, timeout_s: float = 30.0, patience_s: float = 60.0) -> None:
        super().__init__(Connection(url, token, timeout_s), patience_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._connection.close()

    # --- sites and files ---------------------------------------------------------------------
    def create_site(self, site: Site) -> SiteView:
        """Describe a site."""
        return SiteView.model_validate(
            self._connection.json("POST", "/v1/sites", content=site.model_dump_json().encode())
        )

    def sites(self) -> list[SiteView]:
        return [SiteView.model_validate(item) for item in self._connection.items("/v1/sites")]

    def site(self, site_id: str) -> SiteView:
        return SiteView.model_validate(self._connection.json("GET", f"/v1/sites/{site_id}"))

    def replace_site(self, site_id: str, site: Site) -> SiteView:
        """Describe a site anew. Recordings stay with the cameras of the same id; jobs keep their description."""
        content = site.model_dump_json().encode()
        return SiteView.model_validate(self._connection.json("PUT", f"/v1/sites/{site_id}", content=content))

    def delete_site(self, site_id: str) -> None:
        self._connection.request("DELETE", f"/v1/sites/{site_id}")

    def files(self, site_id: str) -> list[FileView]:
        """Recordings, labels, detector and network of a site."""
        return [FileView.model_validate(item) for item in self._connection.items(f"/v1/sites/{site_id}/recordings")]

    def upload_recording(
        self, site_id: str, camera_id: str, path: Path, progress: UploadProgress = lambda sent, size: None
    ) -> None:
        """Send the recording of a camera, or one of the files that the site lists for it.

        A broken connection is taken up where it broke.
        """
        self._send(path, site_id, Purpose.RECORDING, camera_id, progress)

    def upload_labels(self, site_id: str, path: Path, progress: UploadProgress = lambda sent, size: None) -> None:
        """Send hand labels, for evaluation alone."""
        self._send(path, site_id, Purpose.LABELS, "", progress)

    def upload_detector(self, site_id: str, path: Path, progress: UploadProgress = lambda sent, size: None) -> None:
        """Send a 2D detector (ONNX)."""
        self._send(path, site_id, Purpose.DETECTOR, "", progress)

    def upload_network(self, site_id: str, path: Path, progress: UploadProgress = lambda sent, size: None) -> None:
        """Send a 3D network to start fine-tuning from (safetensors, as `wibam weights convert` writes it)."""
        self._send(path, site_id, Purpose.NETWORK, "", progress)

    # --- jobs --------------------------------------------------------------------------------
    def plan(self, site_id: str, options: Mapping[str, Any] | None = None) -> list[PlannedView]:
        """What a job would do. Nothing is started."""
        found = self._connection.json("POST", f"/v1/sites/{site_id}/plan", json={"options": dict(options or {})})
        return [PlannedView.model_validate(item) for item in found]

    def create_job(
        self,
        site_id: str,
        options: Mapping[str, Any] | None = None,
        idempotency_key: str | None = None,
        *,
        name: str = "",
        tags: Iterable[str] = (),
    ) -> JobView:
        """Start a job, under a name and with tags by which it is found again."""
        headers = {"Idempotency-Key": idempotency_key} if idempotency_key is not None else {}
        body = {"options": dict(options or {}), "name": name, "tags": list(tags)}
        return JobView.model_validate(
            self._connection.json("POST", f"/v1/sites/{site_id}/jobs", json=body, headers=headers)
        )

    def job(self, job_id: str) -> JobView:
        return JobView.model_validate(self._connection.json("GET", f"/v1/jobs/{job_id}"))

    def change_job(self, job_id: str, *, name: str | None = None, tags: Iterable[str] | None = None) -> JobView:
        """Call a job something, and give it tags in place of those that it has; None leaves them."""
        body = {"name": name, "tags": None if tags is None else list(tags)}
        return JobView.model_validate(self._connection.json("PATCH", f"/v1/jobs/{job_id}", json=body))

    def jobs(
        self,
        site_id: str | None = None,
        *,
        states: Iterable[JobState] = (),
        tags: Iterable[str] = (),
        text: str = "",
        kind: JobKind = JobKind.TRAINING,
        start: str | None = None,
        end: str | None = None,
        most: int | None = None,
    ) -> list[JobView]:
        """Jobs, the newest first.

        Args:
            site_id: of this site alone.
            states: in one of these; none: in any.
            tags: that have all of these.
            text: that the name or the id contains.
            kind: trainings, or runs of networks.
            start: created then or later; ISO 8601 with its offset from UTC.
            end: created before.
            most: how many at most; None: all.
        """
        params = {"site": site_id, "state": [state.value for state in states], "tag": list(tags), "text": text}
        params |= {"kind": kind.value, "from": start, "to": end}
        return [JobView.model_validate(item) for item in self._connection.items("/v1/jobs", params, most)]

    def wait(
        self,
        job_id: str,
        on_update: Callable[[JobView], None] = lambda job: None,
        *,
        check: Callable[[], None] = lambda: None,
        timeout_s: float | None = None,
        interval_s: float = 0.5,
    ) -> JobView:
        """Wait until a job has ended; it may have failed (`JobView.raise_for_failure`).

        Args:
            job_id: which.
            on_update: told whenever the job has changed.
            check: called before every look; what it raises ends the waiting.
            timeout_s: how long to wait at most.
            interval_s: how often to look.

        Raises:
            TimeoutError: it has not ended by then.
            ServiceUnavailable: the service has not answered for a while (``patience_s``).
        """
        deadline = time.monotonic() + timeout_s if timeout_s is not None else None
        last: JobView | None = None
        answered = time.monotonic()
        while True:
            check()
            try:
                job = self.job(job_id)
            except ServiceUnavailable:
                if time.monotonic() - answered > self._patience_s:
                    raise
            else:
                answered = time.monotonic()
                if job != last:
                    on_update(job)
                    last = job
                if job.state.is_terminal:
                    return job
            if deadline is not None and time.monotonic() > deadline:
                state = last.state if last is not None else "unknown"
                raise TimeoutError(f"job {job_id} is still {state} after {timeout_s:g} s")
            time.sleep(interval_s)

    def cancel(self, job_id: str) -> JobView:
        return JobView.model_validate(self._connection.json("POST", f"/v1/jobs/{job_id}/cancel"))

    def restart(self, job_id: str, from_stage: str | None = None, options: Mapping[str, Any] | None = None) -> JobView:
        """Run again what has no outputs, what changed, and all from ``from_stage`` on."""
        body = {"from_stage": from_stage, "options": dict(options) if options is not None else None}
        return JobView.model_validate(self._connection.json("POST", f"/v1/jobs/{job_id}/restart", json=body))

    def delete_job(self, job_id: str) -> None:
        self._connection.request("DELETE", f"/v1/jobs/{job_id}")

    def log(self, job_id: str, offset: int = 0) -> tuple[str, int, bool]:
        """A part of the log, the offset to go on at, and whether that was all."""
        found = self._connection.json("GET", f"/v1/jobs/{job_id}/log", params={"offset": offset})
        return str(found["text"]), int(found["next_offset"]), bool(found["complete"])

    # --- keys and audit ----------------------------------------------------------------------
    def create_key(self, name: str, scopes: Iterable[str], lifetime_days: float | None = None) -> NewKeyView:
        """A key, with its secret, which is told this once."""
        body = {"name": name, "scopes": list(scopes), "lifetime_days": lifetime_days}
        return NewKeyView.model_validate(self._connection.json("POST", "/v1/keys", json=body))

    def api_keys(self) -> list[KeyView]:
        """The newest first, with those that no longer work."""
        return [KeyView.model_validate(item) for item in self._connection.items("/v1/keys")]

    def revoke_key(self, key_id: str) -> KeyView:
        """Let a key open nothing from now on."""
        return KeyView.model_validate(self._connection.json("DELETE", f"/v1/keys/{quote(key_id, safe='')}"))

    def audit(self, limit: int = 100) -> list[AuditView]:
        """Who changed what, the newest first."""
        found = self._connection.items("/v1/audit", most=limit)
        return [AuditView.model_validate(item) for item in found]
