"""`WibamClient`: what one can ask a service, with types."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import quote

from wibam_core.client.connection import Connection
from wibam_core.client.uploading import UploadProgress, send_file
from wibam_core.client.views import (
    ArtifactView,
    AuditView,
    ClipView,
    FileView,
    FootageView,
    JobView,
    KeyView,
    ModelView,
    NewKeyView,
    PlannedView,
    SiteView,
)
from wibam_core.documents.clips import ClipSpec
from wibam_core.documents.conflicts import Conflicts
from wibam_core.documents.exports import BoxSource, ExportOffer
from wibam_core.documents.hand_labels import Agreement, HandLabels
from wibam_core.documents.metrics import Metrics
from wibam_core.documents.tracks import TrackPage, TrackState
from wibam_core.errors import ServiceUnavailable
from wibam_core.jobs.records import Purpose
from wibam_core.site import Site

#: How long an export may send nothing: some formats are only written once all of a long recording was read.
_EXPORT_TIMEOUT_S = 600.0
#: A network is opened before it is kept, which on a busy machine takes long.
_CHECK_TIMEOUT_S = 300.0


class WibamClient:
    """Talks to one service. A context manager. Errors of the service come back as `WibamError`s of the same kind.

    Args:
        url: e.g. ``http://127.0.0.1:8000``.
        token: the API token.
        timeout_s: for one request without news.
        patience_s: how long uploads and `wait` put up with a service that does not answer.
    """

    def __init__(self, url: str, token: str, timeout_s: float = 30.0, patience_s: float = 60.0) -> None:
        self._connection = Connection(url, token, timeout_s)
        self._patience_s = patience_s

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._connection.close()

    # --- sites and files -----------------------------------------------------------------------
    def create_site(self, site: Site) -> SiteView:
        """Describe a site."""
        return SiteView.model_validate(
            self._connection.json("POST", "/v1/sites", content=site.model_dump_json().encode())
        )

    def sites(self) -> list[SiteView]:
        return [SiteView.model_validate(item) for item in self._connection.json("GET", "/v1/sites")]

    def replace_site(self, site_id: str, site: Site) -> SiteView:
        """Describe a site anew. Recordings stay with the cameras of the same id; jobs keep their description."""
        content = site.model_dump_json().encode()
        return SiteView.model_validate(self._connection.json("PUT", f"/v1/sites/{site_id}", content=content))

    def delete_site(self, site_id: str) -> None:
        self._connection.request("DELETE", f"/v1/sites/{site_id}")

    def files(self, site_id: str) -> list[FileView]:
        """Recordings, labels, detector and network of a site."""
        return [
            FileView.model_validate(item) for item in self._connection.json("GET", f"/v1/sites/{site_id}/recordings")
        ]

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

    def _send(
        self, path: Path, site_id: str, purpose: Purpose, camera_id: str, progress: UploadProgress, started_at: str = ""
    ) -> str:
        return send_file(
            self._connection, path, site_id, purpose, camera_id, progress, self._patience_s, started_at=started_at
        )

    # --- networks and new footage --------------------------------------------------------------
    def models(self, site_id: str | None = None, *, job_id: str | None = None) -> list[ModelView]:
        """The networks that the service keeps, the newest first."""
        params = {name: value for name, value in (("site", site_id), ("job", job_id)) if value is not None}
        return [ModelView.model_validate(item) for item in self._connection.json("GET", "/v1/models", params=params)]

    def model(self, model_id: str) -> ModelView:
        return ModelView.model_validate(self._connection.json("GET", f"/v1/models/{model_id}"))

    def keep_model(
        self, site_id: str, path: Path, name: str = "", progress: UploadProgress = lambda sent, size: None
    ) -> ModelView:
        """Send a network (safetensors) for the service to keep, once it has checked it."""
        file_id = self._send(path, site_id, Purpose.MODEL, "", progress)
        body = {"site_id": site_id, "file_id": file_id, "name": name}
        return ModelView.model_validate(
            self._connection.json("POST", "/v1/models", json=body, timeout=_CHECK_TIMEOUT_S)
        )

    def change_model(self, model_id: str, *, name: str | None = None, state: str | None = None) -> ModelView:
        """Call a network something; make it "promoted", "retired" or a "candidate" again."""
        body = {key: value for key, value in (("name", name), ("state", state)) if value is not None}
        return ModelView.model_validate(self._connection.json("PATCH", f"/v1/models/{model_id}", json=body))

    def delete_model(self, model_id: str) -> None:
        self._connection.request("DELETE", f"/v1/models/{model_id}")

    def download_kept_model(self, model_id: str, target: Path, format: str = "safetensors") -> Path:
        """A network that the service keeps, as a "safetensors" or "onnx" file."""
        return self._connection.download(f"/v1/models/{model_id}/file", target, {"format": format})

    def upload_footage(
        self,
        site_id: str,
        camera_id: str,
        path: Path,
        started_at: str = "",
        progress: UploadProgress = lambda sent, size: None,
    ) -> str:
        """Send footage of a camera; returns the file's id.

        Args:
            site_id: whose camera it is.
            camera_id: which.
            path: the file.
            started_at: when its first frame was taken, ISO 8601 with its offset from UTC; empty: unknown.
            progress: told how much has arrived.
        """
        return self._send(path, site_id, Purpose.FOOTAGE, camera_id, progress, started_at)

    def footage(self, site_id: str, camera_id: str | None = None) -> list[FootageView]:
        """All footage of a site's cameras, the recordings included."""
        params = {} if camera_id is None else {"camera": camera_id}
        found = self._connection.json("GET", f"/v1/sites/{site_id}/footage", params=params)
        return [FootageView.model_validate(item) for item in found]

    def delete_footage(self, site_id: str, file_id: str) -> None:
        self._connection.request("DELETE", f"/v1/sites/{site_id}/footage/{file_id}")

    def create_run(
        self,
        model_id: str,
        files: Sequence[str],
        options: Mapping[str, Any] | None = None,
        *,
        continues: str | None = None,
        name: str = "",
        idempotency_key: str | None = None,
    ) -> JobView:
        """Run a network on footage; the answer is a job, with tracks and conflicts of its own.

        Args:
            model_id: the network.
            files: ids of footage, of one camera or several.
            options: of the stages of a run.
            continues: id of the run before: who is in view at the joint keeps their id.
            name: what you call it.
            idempotency_key: a second call with the same key gets the same run.
        """
        headers = {"Idempotency-Key": idempotency_key} if idempotency_key is not None else {}
        body = {"files": list(files), "options": dict(options or {}), "continues": continues, "name": name}
        return JobView.model_validate(
            self._connection.json("POST", f"/v1/models/{model_id}/runs", json=body, headers=headers)
        )

    def runs(self, model_id: str) -> list[JobView]:
        """The runs of a network, the newest first."""
        return [JobView.model_validate(item) for item in self._connection.json("GET", f"/v1/models/{model_id}/runs")]

    # --- jobs ----------------------------------------------------------------------------------
    def plan(self, site_id: str, options: Mapping[str, Any] | None = None) -> list[PlannedView]:
        """What a job would do. Nothing is started."""
        found = self._connection.json("POST", f"/v1/sites/{site_id}/plan", json={"options": dict(options or {})})
        return [PlannedView.model_validate(item) for item in found]

    def create_job(
        self, site_id: str, options: Mapping[str, Any] | None = None, idempotency_key: str | None = None
    ) -> JobView:
        """Start a job."""
        headers = {"Idempotency-Key": idempotency_key} if idempotency_key is not None else {}
        body = {"options": dict(options or {})}
        return JobView.model_validate(
            self._connection.json("POST", f"/v1/sites/{site_id}/jobs", json=body, headers=headers)
        )

    def job(self, job_id: str) -> JobView:
        return JobView.model_validate(self._connection.json("GET", f"/v1/jobs/{job_id}"))

    def jobs(self, site_id: str | None = None) -> list[JobView]:
        """The newest first."""
        params = {"site": site_id} if site_id is not None else {}
        return [JobView.model_validate(item) for item in self._connection.json("GET", "/v1/jobs", params=params)]

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

    # --- keys and audit ------------------------------------------------------------------------
    def create_key(self, name: str, scopes: Iterable[str], lifetime_days: float | None = None) -> NewKeyView:
        """A key, with its secret, which is told this once."""
        body = {"name": name, "scopes": list(scopes), "lifetime_days": lifetime_days}
        return NewKeyView.model_validate(self._connection.json("POST", "/v1/keys", json=body))

    def api_keys(self) -> list[KeyView]:
        """The newest first, with those that no longer work."""
        return [KeyView.model_validate(item) for item in self._connection.json("GET", "/v1/keys")]

    def revoke_key(self, key_id: str) -> KeyView:
        """Let a key open nothing from now on."""
        return KeyView.model_validate(self._connection.json("DELETE", f"/v1/keys/{quote(key_id, safe='')}"))

    def audit(self, limit: int = 100) -> list[AuditView]:
        """Who changed what, the newest first."""
        found = self._connection.json("GET", "/v1/audit", params={"limit": limit})
        return [AuditView.model_validate(item) for item in found]

    # --- results -------------------------------------------------------------------------------
    def metrics(self, job_id: str) -> Metrics:
        """How good the networks are."""
        return Metrics.model_validate(self._connection.json("GET", f"/v1/jobs/{job_id}/metrics"))

    def conflicts(self, job_id: str) -> Conflicts:
        """Conflicts between road users."""
        return Conflicts.model_validate(self._connection.json("GET", f"/v1/jobs/{job_id}/conflicts"))

    def tracks(self, job_id: str, **query: Any) -> Iterator[TrackState]:
        """States of vehicles, sorted by time, fetched page by page.

        Args:
            job_id: which.
            query: parameters of ``GET /v1/jobs/{id}/tracks``: ``start_ns``, ``end_ns``, ``bounds``, ``polygon``,
                ``track_id``, ``min_speed_mps``; ``vehicle_class`` for its ``class``.
        """
        params = _track_params(query)
        while True:
            answer = self._connection.json("GET", f"/v1/jobs/{job_id}/tracks", params=params)
            page = TrackPage.model_validate(answer)
            yield from page.states
            if page.next is None:
                return
            params["cursor"] = page.next

    def download_tracks(self, job_id: str, target: Path, format: str = "parquet", **query: Any) -> Path:
        """All matching states as a "parquet", "csv" or "json" file; ``query`` as in `tracks`."""
        if format == "json":
            page = TrackPage(states=list(self.tracks(job_id, **query)), next=None)
            target.write_text(page.model_dump_json(by_alias=True), encoding="utf-8")
            return target
        params = {**_track_params(query), "format": format}
        return self._connection.download(f"/v1/jobs/{job_id}/tracks", target, params)

    def download_conflicts(self, job_id: str, target: Path, format: str = "csv") -> Path:
        return self._connection.download(f"/v1/jobs/{job_id}/conflicts", target, {"format": format})

    def download_model(self, job_id: str, target: Path, format: str = "safetensors") -> Path:
        """The fine-tuned model as a "safetensors" or "onnx" file."""
        return self._connection.download(f"/v1/jobs/{job_id}/model", target, {"format": format})

    def download_report(self, job_id: str, target: Path) -> Path:
        """The HTML report."""
        return self._connection.download(f"/v1/jobs/{job_id}/report", target)

    def report_url(self, job_id: str) -> str:
        """A link that opens the report in a browser, for some minutes."""
        return self._connection.address(self._connection.json("GET", f"/v1/jobs/{job_id}/report-link")["url"])

    def exports(self, job_id: str) -> list[ExportOffer]:
        """The formats that a job can be exported in, and what is missing for the others."""
        return [ExportOffer.model_validate(item) for item in self._connection.json("GET", f"/v1/jobs/{job_id}/exports")]

    def download_export(self, job_id: str, format: str, target: Path, boxes: BoxSource = BoxSource.FITS) -> Path:
        """The results in a format of others: one file, or a zip archive of several.

        Args:
            job_id: which.
            format: its name, see `exports`.
            target: a file, or a folder to put it into under the name that the service gives it.
            boxes: which 3D boxes, in formats that hold some.
        """
        path = f"/v1/jobs/{job_id}/exports/{quote(format, safe='')}"
        return self._connection.download(path, target, {"boxes": boxes.value}, timeout_s=_EXPORT_TIMEOUT_S)

    # --- hand labels ---------------------------------------------------------------------------
    def instants(self, job_id: str) -> list[int]:
        """The instants of which frames are stored, in ns on the reference clock."""
        return [int(time_ns) for time_ns in self._connection.json("GET", f"/v1/jobs/{job_id}/instants")["times_ns"]]

    def labels(self, job_id: str, time_ns: int, label_set: str = "main") -> tuple[HandLabels, int]:
        """What somebody labelled at an instant, and the version of it: 0 where nobody did."""
        path = f"/v1/jobs/{job_id}/labels/instants/{time_ns}"
        found = self._connection.json("GET", path, params={"set": label_set})
        return HandLabels.model_validate(found["labels"]), int(found["version"])

    def save_labels(self, job_id: str, labels: HandLabels, author: str, made_from: int, label_set: str = "main") -> int:
        """Save the labels of an instant; returns their version.

        Args:
            job_id: whose footage.
            labels: all of the instant.
            author: who made them.
            made_from: the version that they were made from (`labels`).
            label_set: whose they are.

        Raises:
            ChangedMeanwhile: somebody else has saved since; nothing was changed.
        """
        body = labels.model_dump(mode="json", include={"vehicles", "finished", "seconds"}) | {"author": author}
        path, match = f"/v1/jobs/{job_id}/labels/instants/{labels.time_ns}", {"If-Match": f'"{made_from}"'}
        found = self._connection.json("PUT", path, params={"set": label_set}, headers=match, json=body)
        return int(found["version"])

    def agreement(self, job_id: str, first: str, second: str) -> Agreement:
        """How far two sets of labels agree."""
        params = {"first": first, "second": second}
        return Agreement.model_validate(
            self._connection.json("GET", f"/v1/jobs/{job_id}/labels/agreement", params=params)
        )

    def download_labels(self, job_id: str, target: Path, format: str = "parquet", label_set: str = "main") -> Path:
        """The finished labels as a "parquet" or "json" labels file, or in an exchange format."""
        path = f"/v1/jobs/{job_id}/labels/export/{quote(format, safe='')}"
        return self._connection.download(path, target, {"set": label_set}, timeout_s=_EXPORT_TIMEOUT_S)

    # --- clips ---------------------------------------------------------------------------------
    def create_clip(self, job_id: str, spec: ClipSpec) -> ClipView:
        """Ask for a video clip of a job's results."""
        content = spec.model_dump_json().encode()
        return ClipView.model_validate(self._connection.json("POST", f"/v1/jobs/{job_id}/clips", content=content))

    def clips(self, job_id: str) -> list[ClipView]:
        """The newest first."""
        return [ClipView.model_validate(item) for item in self._connection.json("GET", f"/v1/jobs/{job_id}/clips")]

    def wait_for_clip(
        self,
        job_id: str,
        clip_id: str,
        on_update: Callable[[ClipView], None] = lambda clip: None,
        interval_s: float = 0.5,
    ) -> ClipView:
        """Wait until a clip is rendered or has failed (`ClipView.raise_for_failure`).

        Args:
            job_id: whose.
            clip_id: which.
            on_update: told how it stands, at every look.
            interval_s: how often to look.
        """
        while True:
            clip = ClipView.model_validate(self._connection.json("GET", f"/v1/jobs/{job_id}/clips/{clip_id}"))
            on_update(clip)
            if clip.state.is_terminal:
                return clip
            time.sleep(interval_s)

    def download_clip(self, job_id: str, clip_id: str, target: Path) -> Path:
        """The finished clip as an MP4 file."""
        return self._connection.download(f"/v1/jobs/{job_id}/clips/{clip_id}/video", target)

    def delete_clip(self, job_id: str, clip_id: str) -> None:
        self._connection.request("DELETE", f"/v1/jobs/{job_id}/clips/{clip_id}")

    def artifacts(self, job_id: str) -> list[ArtifactView]:
        return [
            ArtifactView.model_validate(item) for item in self._connection.json("GET", f"/v1/jobs/{job_id}/artifacts")
        ]

    def download_artifact(self, job_id: str, artifact_id: str, target: Path) -> Path:
        """A file by its id, e.g. ``"evaluate/metrics.json"``."""
        return self._connection.download(f"/v1/jobs/{job_id}/artifacts/{artifact_id}", target)


def _track_params(query: Mapping[str, Any]) -> dict[str, Any]:
    params = {name: value for name, value in query.items() if value is not None}
    if "vehicle_class" in params:
        params["class"] = params.pop("vehicle_class")
    return params
