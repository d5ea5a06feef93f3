"""Networks that the service keeps, and new footage for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from wibam_core.client.requests import Requests
from wibam_core.client.uploading import UploadProgress
from wibam_core.client.views import (
    FootageView,
    JobView,
    ModelView,
)
from wibam_core.documents.comparison import NetworkComparison
from wibam_core.jobs.records import Purpose

#: A network is opened before it is kept, which on a busy machine takes long.
_CHECK_TIMEOUT_S = 300.0


class NetworkRequests(Requests):
    """Networks that the service keeps, and new footage for them."""

    def models(self, site_id: str | None = None, *, job_id: str | None = None) -> list[ModelView]:
        """The networks that the service keeps, the newest first."""
        found = self._connection.items("/v1/models", {"site": site_id, "job": job_id})
        return [ModelView.model_validate(item) for item in found]

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

    def compare_models(self, first_id: str, second_id: str) -> NetworkComparison:
        """Two networks on the same held-out instants."""
        found = self._connection.json(
            "GET", "/v1/models/compare", params={"first": first_id, "second": second_id}, timeout=_CHECK_TIMEOUT_S
        )
        return NetworkComparison.model_validate(found)

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

    def footage(
        self, site_id: str, camera_id: str | None = None, began: tuple[datetime, datetime] | None = None
    ) -> list[FootageView]:
        """The footage of a site's cameras, the recordings included.

        Args:
            site_id: whose cameras.
            camera_id: of one camera alone.
            began: that began at the first of two times, or later, and before the second.
        """
        times = {} if began is None else {"from": began[0].isoformat(), "to": began[1].isoformat()}
        found = self._connection.items(f"/v1/sites/{site_id}/footage", {"camera": camera_id, **times})
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
        return [JobView.model_validate(item) for item in self._connection.items(f"/v1/models/{model_id}/runs")]
