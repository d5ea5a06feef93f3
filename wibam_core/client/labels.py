"""Hand labels of a job."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

from wibam_core.client.requests import Requests
from wibam_core.documents.hand_labels import Agreement, HandLabels

#: How long an export may send nothing: some formats are only written once all of a long recording was read.
_EXPORT_TIMEOUT_S = 600.0


class LabelRequests(Requests):
    """Hand labels of a job."""

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
        said = {"vehicles", "regions", "finished", "seconds"}
        body = labels.model_dump(mode="json", include=said) | {"author": author}
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
