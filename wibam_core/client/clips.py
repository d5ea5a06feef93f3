"""Video clips of a job."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from wibam_core.client.requests import Requests
from wibam_core.client.views import (
    ClipView,
)
from wibam_core.documents.clips import ClipSpec


class ClipRequests(Requests):
    """Video clips of a job."""

    def create_clip(self, job_id: str, spec: ClipSpec) -> ClipView:
        """Ask for a video clip of a job's results."""
        content = spec.model_dump_json().encode()
        return ClipView.model_validate(self._connection.json("POST", f"/v1/jobs/{job_id}/clips", content=content))

    def clips(self, job_id: str) -> list[ClipView]:
        """The newest first."""
        return [ClipView.model_validate(item) for item in self._connection.items(f"/v1/jobs/{job_id}/clips")]

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
