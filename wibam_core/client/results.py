"""What came out of a job: figures, tracks, files in many formats."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from wibam_core.client.requests import Requests
from wibam_core.client.views import (
    ArtifactView,
)
from wibam_core.documents.conflicts import Conflicts
from wibam_core.documents.exports import BoxSource, ExportOffer
from wibam_core.documents.metrics import Metrics
from wibam_core.documents.tracks import CompactTracks, TrackPage, TrackPaths, TracksSummary, TrackState

#: How long an export may send nothing: some formats are only written once all of a long recording was read.
_EXPORT_TIMEOUT_S = 600.0


class ResultRequests(Requests):
    """What came out of a job: figures, tracks, files in many formats."""

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

    def tracks_summary(self, job_id: str, **query: Any) -> TracksSummary:
        """How many states and tracks match, when and where; ``query`` as in `tracks`."""
        path = f"/v1/jobs/{job_id}/tracks/summary"
        return TracksSummary.model_validate(self._connection.json("GET", path, params=_track_params(query)))

    def compact_tracks(self, job_id: str, **query: Any) -> Iterator[CompactTracks]:
        """The states by track and rounded, for drawing, page by page; ``query`` as in `tracks`."""
        path, params = f"/v1/jobs/{job_id}/tracks/compact", _track_params(query)
        while True:
            page = CompactTracks.model_validate(self._connection.json("GET", path, params=params))
            yield page
            if page.next is None:
                return
            params["cursor"] = page.next

    def track_paths(self, job_id: str, **query: Any) -> TrackPaths:
        """Where road users went, as few lines as can be drawn together; ``query`` as in `tracks`."""
        path = f"/v1/jobs/{job_id}/tracks/paths"
        return TrackPaths.model_validate(self._connection.json("GET", path, params=_track_params(query)))

    def download_tracks(self, job_id: str, target: Path, format: str = "parquet", **query: Any) -> Path:
        """All matching states as a "parquet", "csv" or "json" file; ``query`` as in `tracks`."""
        if format == "json":
            page = TrackPage(states=list(self.tracks(job_id, **query)), next=None)
            target.write_text(page.model_dump_json(by_alias=True), encoding="utf-8")
            return target
        params = {**_track_params(query), "format": format}
        return self._connection.download(f"/v1/jobs/{job_id}/tracks", target, params)

    def download_conflicts(self, job_id: str, target: Path, format: str = "csv", *, reviews: bool = False) -> Path:
        """As a "csv", "pdf" or "json" file; CSV and PDF with what people said of each where ``reviews`` says so."""
        params = {"format": format, **({"reviews": "true"} if reviews else {})}
        return self._connection.download(f"/v1/jobs/{job_id}/conflicts", target, params)

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

    def artifacts(self, job_id: str) -> list[ArtifactView]:
        return [ArtifactView.model_validate(item) for item in self._connection.items(f"/v1/jobs/{job_id}/artifacts")]

    def download_archive(
        self, job_id: str, target: Path, *, stages: Iterable[str] = (), artifacts: Iterable[str] = ()
    ) -> Path:
        """A job's files as one zip archive, in a folder with its id.

        Args:
            job_id: which.
            target: a file, or a folder to put it into under the name that the service gives it.
            stages: what these have written; none: all.
            artifacts: what is a part of these; none: all.
        """
        params = {"stage": list(stages), "artifact": list(artifacts)}
        return self._connection.download(f"/v1/jobs/{job_id}/archive", target, params)

    def download_artifact(self, job_id: str, artifact_id: str, target: Path) -> Path:
        """A file by its id, e.g. ``"evaluate/metrics.json"``."""
        return self._connection.download(f"/v1/jobs/{job_id}/artifacts/{artifact_id}", target)


def _track_params(query: Mapping[str, Any]) -> dict[str, Any]:
    params = {name: value for name, value in query.items() if value is not None}
    if "vehicle_class" in params:
        params["class"] = params.pop("vehicle_class")
    return params
