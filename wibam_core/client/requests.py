"""What all groups of requests to a service share."""

from __future__ import annotations

from pathlib import Path

from wibam_core.client.connection import Connection
from wibam_core.client.uploading import UploadProgress, send_file
from wibam_core.jobs.records import Purpose


class Requests:
    """Requests over one connection; see `wibam_core.client.client.WibamClient`, which has them all."""

    def __init__(self, connection: Connection, patience_s: float) -> None:
        self._connection = connection
        self._patience_s = patience_s

    def _send(
        self, path: Path, site_id: str, purpose: Purpose, camera_id: str, progress: UploadProgress, started_at: str = ""
    ) -> str:
        return send_file(
            self._connection, path, site_id, purpose, camera_id, progress, self._patience_s, started_at=started_at
        )
