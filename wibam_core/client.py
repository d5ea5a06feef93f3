"""A typed client for the service's HTTP API, with resumable uploads.

```python
with WibamClient("http://127.0.0.1:8000", token) as client:
    site = client.create_site(Site.load(folder / "site.json"))
    client.upload_recording(site.id, "north", folder / "recordings" / "north.mp4")
    job = client.wait(client.create_job(site.id).id)
    client.download_model(job.id, Path("weights.safetensors"))
```
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx
from pydantic import BaseModel, ConfigDict

from wibam_core.errors import ChecksumMismatch, Conflict, Locked, ServiceUnavailable, WibamError
from wibam_core.jobs.records import Purpose
from wibam_core.jobs.states import JobState, StageState
from wibam_core.site import Site

_PIECE_BYTES = 16 * 1024 * 1024
_BLOCK_BYTES = 256 * 1024
_TUS = {"Tus-Resumable": "1.0.0"}
_FAILURES_WITHOUT_PROGRESS = 6

#: Told the bytes that are safely at the service, and the size of the file.
UploadProgress = Callable[[int, int], None]


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
    error: ProblemView | None = None
    seconds: float | None = None


class JobView(_View):
    """A job as it stands."""

    id: str
    site_id: str
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
    size_bytes: int
    sha256: str


class WibamClient:
    """Talks to one service. A context manager. Errors of the service come back as `WibamError`s of the same kind.

    Args:
        url: e.g. ``http://127.0.0.1:8000``.
        token: the API token.
        timeout_s: for one request without news.
    """

    def __init__(self, url: str, token: str, timeout_s: float = 30.0) -> None:
        self._http = httpx.Client(
            base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=timeout_s, follow_redirects=False
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._http.close()

    # --- sites and files -----------------------------------------------------------------------
    def create_site(self, site: Site) -> SiteView:
        """Describe a site."""
        return SiteView.model_validate(self._json("POST", "/v1/sites", content=site.model_dump_json().encode()))

    def sites(self) -> list[SiteView]:
        return [SiteView.model_validate(item) for item in self._json("GET", "/v1/sites")]

    def delete_site(self, site_id: str) -> None:
        self._request("DELETE", f"/v1/sites/{site_id}")

    def files(self, site_id: str) -> list[FileView]:
        """Recordings, labels and detector of a site."""
        return [FileView.model_validate(item) for item in self._json("GET", f"/v1/sites/{site_id}/recordings")]

    def upload_recording(
        self, site_id: str, camera_id: str, path: Path, progress: UploadProgress = lambda sent, size: None
    ) -> None:
        """Send the recording of a camera. A broken connection is taken up where it broke."""
        self._upload(site_id, Purpose.RECORDING, camera_id, path, progress)

    def upload_labels(self, site_id: str, path: Path, progress: UploadProgress = lambda sent, size: None) -> None:
        """Send hand labels, for evaluation alone."""
        self._upload(site_id, Purpose.LABELS, "", path, progress)

    def upload_detector(self, site_id: str, path: Path, progress: UploadProgress = lambda sent, size: None) -> None:
        """Send a 2D detector (ONNX)."""
        self._upload(site_id, Purpose.DETECTOR, "", path, progress)

    # --- jobs ----------------------------------------------------------------------------------
    def plan(self, site_id: str, options: Mapping[str, Any] | None = None) -> list[PlannedView]:
        """What a job would do. Nothing is started."""
        found = self._json("POST", f"/v1/sites/{site_id}/plan", json={"options": dict(options or {})})
        return [PlannedView.model_validate(item) for item in found]

    def create_job(
        self, site_id: str, options: Mapping[str, Any] | None = None, idempotency_key: str | None = None
    ) -> JobView:
        """Start a job."""
        headers = {"Idempotency-Key": idempotency_key} if idempotency_key is not None else {}
        body = {"options": dict(options or {})}
        return JobView.model_validate(self._json("POST", f"/v1/sites/{site_id}/jobs", json=body, headers=headers))

    def job(self, job_id: str) -> JobView:
        return JobView.model_validate(self._json("GET", f"/v1/jobs/{job_id}"))

    def jobs(self, site_id: str | None = None) -> list[JobView]:
        """The newest first."""
        params = {"site": site_id} if site_id is not None else {}
        return [JobView.model_validate(item) for item in self._json("GET", "/v1/jobs", params=params)]

    def wait(
        self,
        job_id: str,
        on_update: Callable[[JobView], None] = lambda job: None,
        *,
        timeout_s: float | None = None,
        interval_s: float = 0.5,
    ) -> JobView:
        """Wait until a job has ended; it may have failed (`JobView.raise_for_failure`).

        Args:
            job_id: which.
            on_update: told whenever the job has changed.
            timeout_s: how long to wait at most.
            interval_s: how often to look.

        Raises:
            TimeoutError: it has not ended by then.
        """
        deadline = time.monotonic() + timeout_s if timeout_s is not None else None
        last: JobView | None = None
        while True:
            job = self.job(job_id)
            if job != last:
                on_update(job)
                last = job
            if job.state.is_terminal:
                return job
            if deadline is not None and time.monotonic() > deadline:
                raise TimeoutError(f"job {job_id} is still {job.state} after {timeout_s:g} s")
            time.sleep(interval_s)

    def cancel(self, job_id: str) -> JobView:
        return JobView.model_validate(self._json("POST", f"/v1/jobs/{job_id}/cancel"))

    def restart(self, job_id: str, from_stage: str | None = None, options: Mapping[str, Any] | None = None) -> JobView:
        """Run again what has no outputs, what changed, and all from ``from_stage`` on."""
        body = {"from_stage": from_stage, "options": dict(options) if options is not None else None}
        return JobView.model_validate(self._json("POST", f"/v1/jobs/{job_id}/restart", json=body))

    def delete_job(self, job_id: str) -> None:
        self._request("DELETE", f"/v1/jobs/{job_id}")

    def log(self, job_id: str, offset: int = 0) -> tuple[str, int, bool]:
        """A part of the log, the offset to go on at, and whether that was all."""
        found = self._json("GET", f"/v1/jobs/{job_id}/log", params={"offset": offset})
        return str(found["text"]), int(found["next_offset"]), bool(found["complete"])

    # --- results -------------------------------------------------------------------------------
    def metrics(self, job_id: str) -> dict[str, Any]:
        """The contents of ``metrics.json``."""
        return dict(self._json("GET", f"/v1/jobs/{job_id}/metrics"))

    def conflicts(self, job_id: str) -> dict[str, Any]:
        """The contents of ``conflicts.json``."""
        return dict(self._json("GET", f"/v1/jobs/{job_id}/conflicts"))

    def tracks(self, job_id: str, **query: Any) -> Iterator[dict[str, Any]]:
        """States of vehicles, sorted by time, fetched page by page.

        Args:
            job_id: which.
            query: parameters of ``GET /v1/jobs/{id}/tracks``: ``start_ns``, ``end_ns``, ``bounds``, ``polygon``,
                ``track_id``, ``min_speed_mps``; ``vehicle_class`` for its ``class``.
        """
        params = _track_params(query)
        while True:
            page = self._json("GET", f"/v1/jobs/{job_id}/tracks", params=params)
            yield from page["states"]
            if page["next"] is None:
                return
            params["cursor"] = page["next"]

    def download_tracks(self, job_id: str, target: Path, format: str = "parquet", **query: Any) -> Path:
        """All matching states as a "parquet", "csv" or "json" file; ``query`` as in `tracks`."""
        if format == "json":
            target.write_text(json.dumps({"states": list(self.tracks(job_id, **query))}), encoding="utf-8")
            return target
        params = {**_track_params(query), "format": format}
        return self._download(f"/v1/jobs/{job_id}/tracks", target, params)

    def download_conflicts(self, job_id: str, target: Path, format: str = "csv") -> Path:
        return self._download(f"/v1/jobs/{job_id}/conflicts", target, {"format": format})

    def download_model(self, job_id: str, target: Path) -> Path:
        """The fine-tuned weights (safetensors)."""
        return self._download(f"/v1/jobs/{job_id}/model", target)

    def download_report(self, job_id: str, target: Path) -> Path:
        """The HTML report."""
        return self._download(f"/v1/jobs/{job_id}/report", target)

    def report_url(self, job_id: str) -> str:
        """A link that opens the report in a browser, for some minutes."""
        return str(self._http.base_url.join(self._json("GET", f"/v1/jobs/{job_id}/report-link")["url"]))

    def artifacts(self, job_id: str) -> list[ArtifactView]:
        return [ArtifactView.model_validate(item) for item in self._json("GET", f"/v1/jobs/{job_id}/artifacts")]

    def download_artifact(self, job_id: str, artifact_id: str, target: Path) -> Path:
        """A file by its id, e.g. ``"evaluate/metrics.json"``."""
        return self._download(f"/v1/jobs/{job_id}/artifacts/{artifact_id}", target)

    # --- underneath ----------------------------------------------------------------------------
    def _upload(self, site_id: str, purpose: Purpose, camera_id: str, path: Path, progress: UploadProgress) -> None:
        size = path.stat().st_size
        values = {"site": site_id, "purpose": purpose.value, "camera": camera_id, "filename": path.name}
        metadata = ",".join(f"{key} {base64.b64encode(value.encode()).decode()}" for key, value in values.items())
        begun = self._request(
            "POST", "/v1/uploads", headers={**_TUS, "Upload-Length": str(size), "Upload-Metadata": metadata}
        )
        address, offset, failures = begun.headers["Location"], 0, 0
        while offset < size:
            try:
                sent = self._send_piece(address, path, offset)
            except (ServiceUnavailable, Locked, Conflict) as error:
                failures += 1
                if failures >= _FAILURES_WITHOUT_PROGRESS:
                    raise
                time.sleep(min(0.25 * 2**failures, 5.0))
                sent = self._acknowledged(address, offset, error)
            if sent > offset:
                failures = 0
            offset = sent
            progress(offset, size)

    def _send_piece(self, address: str, path: Path, offset: int) -> int:
        length = min(_PIECE_BYTES, path.stat().st_size - offset)
        headers = {
            **_TUS,
            "Upload-Offset": str(offset),
            "Content-Type": "application/offset+octet-stream",
            "Content-Length": str(length),
        }
        response = self._request("PATCH", address, content=_bytes_of(path, offset, length), headers=headers)
        return int(response.headers["Upload-Offset"])

    def _acknowledged(self, address: str, offset: int, cause: WibamError) -> int:
        try:
            return int(self._request("HEAD", address, headers=_TUS).headers["Upload-Offset"])
        except ServiceUnavailable:
            return offset
        except WibamError as error:
            raise error from cause

    def _json(self, method: str, path: str, **values: Any) -> Any:
        if "content" in values:
            values["headers"] = {**values.get("headers", {}), "Content-Type": "application/json"}
        return self._request(method, path, **values).json()

    def _request(self, method: str, path: str, **values: Any) -> httpx.Response:
        try:
            response = self._http.request(method, path, **values)
        except httpx.TransportError as error:
            raise ServiceUnavailable(f"no answer from {self._http.base_url}: {error}") from error
        _raise_for_problem(response)
        return response

    def _download(self, path: str, target: Path, params: Mapping[str, Any] | None = None) -> Path:
        """Fetch into ``target``, which appears only once it is whole and, where the service says its digest, right."""
        partial = target.with_name(target.name + ".part")
        digest = hashlib.sha256()
        try:
            with self._http.stream("GET", path, params=dict(params or {})) as response:
                if response.is_error:
                    response.read()
                _raise_for_problem(response)
                with partial.open("wb") as file:
                    for block in response.iter_bytes():
                        file.write(block)
                        digest.update(block)
        except httpx.TransportError as error:
            partial.unlink(missing_ok=True)
            raise ServiceUnavailable(f"the download of {path} broke off: {error}") from error
        announced = re.fullmatch(r"sha-256=:(.+):", response.headers.get("Repr-Digest", ""))
        if announced and base64.b64decode(announced[1]) != digest.digest():
            partial.unlink()
            raise ChecksumMismatch(f"{path} was damaged on its way", hint="Download it again.")
        partial.replace(target)
        return target


def _track_params(query: Mapping[str, Any]) -> dict[str, Any]:
    params = {name: value for name, value in query.items() if value is not None}
    if "vehicle_class" in params:
        params["class"] = params.pop("vehicle_class")
    return params


def _bytes_of(path: Path, offset: int, length: int) -> Iterator[bytes]:
    with path.open("rb") as file:
        file.seek(offset)
        while length > 0 and (block := file.read(min(_BLOCK_BYTES, length))):
            length -= len(block)
            yield block


def _raise_for_problem(response: httpx.Response) -> None:
    if response.is_success:
        return
    try:
        body = response.json()
    except ValueError:
        body = {}
    if not isinstance(body, dict) or "code" not in body:
        body = _without_body(response.status_code)
    raise WibamError.from_dict(
        {
            "code": body["code"],
            "message": body.get("detail", ""),
            "hint": body.get("hint"),
            "details": body.get("details"),
        }
    )


def _without_body(status: int) -> dict[str, Any]:
    codes: Sequence[tuple[int, str]] = ((401, "unauthorised"), (404, "not_found"), (409, "conflict"), (423, "locked"))
    unavailable = status in (502, 503, 504)
    code = dict(codes).get(status, "service_unavailable" if unavailable else "http_error")
    return {"code": code, "detail": f"the service answered with status {status}", "hint": ""}
