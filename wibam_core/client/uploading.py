"""Sending one file over tus 1.0, through broken connections, restarts of the service, and its own slow moments."""

from __future__ import annotations

import base64
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from wibam_core.client.connection import Connection
from wibam_core.errors import Conflict, Locked, ServiceUnavailable, WibamError
from wibam_core.jobs.records import Purpose

_PIECE_BYTES = 16 * 1024 * 1024
_BLOCK_BYTES = 256 * 1024
_TUS = {"Tus-Resumable": "1.0.0"}
_FIRST_PAUSE_S = 0.25
_LONGEST_PAUSE_S = 5.0
_FEWEST_TRIES = 6
_STALLED = "upload_stalled"

#: Told the bytes that are safely at the service, and the size of the file.
UploadProgress = Callable[[int, int], None]


def send_file(
    connection: Connection,
    path: Path,
    site_id: str,
    purpose: Purpose,
    camera_id: str,
    progress: UploadProgress,
    patience_s: float,
    started_at: str = "",
) -> str:
    """Upload a file; ``patience_s`` is how long a service that does not answer is waited for.

    Returns:
        The file's id.

    Raises:
        ServiceUnavailable: it stayed away for longer than that.
        WibamError: it refuses the file.
    """
    size = path.stat().st_size
    values = {"site": site_id, "purpose": purpose.value, "camera": camera_id, "filename": path.name}
    values |= {"started_at": started_at} if started_at else {}
    metadata = ",".join(f"{key} {base64.b64encode(value.encode()).decode()}" for key, value in values.items())
    headers = {**_TUS, "Upload-Length": str(size), "Upload-Metadata": metadata}
    address = connection.request("POST", "/v1/uploads", headers=headers).headers["Location"]
    offset, trouble = 0, _Trouble(patience_s)
    while offset < size:
        try:
            reached = _send_piece(connection, address, path, offset, size)
        except WibamError as error:
            reached = trouble.recover(connection, address, offset, error)
        if reached != offset:
            trouble = _Trouble(patience_s)
        offset = reached
        progress(offset, size)
    return address.rstrip("/").rpartition("/")[2]


class _Trouble:
    """What has gone wrong since bytes were last acknowledged, and whether to try on.

    A locked upload is no trouble, and is waited for however long that takes: the service answers, and works on it. It
    writes what came over a connection that has broken meanwhile, or reads a long file once more before it is complete.
    """

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._tries = 0
        self._since = time.monotonic()
        self._pause_s = _FIRST_PAUSE_S

    def recover(self, connection: Connection, address: str, offset: int, error: WibamError) -> int:
        """Wait a little, then ask how many bytes the service has.

        Raises:
            WibamError: the error itself, if trying on is of no use.
        """
        if isinstance(error, Locked):
            self._tries, self._since = 0, time.monotonic()
        elif isinstance(error, ServiceUnavailable) or error.code == _STALLED:
            self._tries += 1
            if self._tries >= _FEWEST_TRIES and time.monotonic() - self._since >= self._patience_s:
                raise error
        elif not isinstance(error, Conflict):
            raise error
        time.sleep(self._pause_s)
        self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S)
        try:
            reached = int(connection.request("HEAD", address, headers=_TUS).headers["Upload-Offset"])
        except ServiceUnavailable:
            return offset
        except WibamError as refused:
            raise refused from error
        if isinstance(error, Conflict) and reached == offset:
            raise error  # this is where it wants to go on, and it does not want these bytes
        return reached


def _send_piece(connection: Connection, address: str, path: Path, offset: int, size: int) -> int:
    length = min(_PIECE_BYTES, size - offset)
    headers = {
        **_TUS,
        "Upload-Offset": str(offset),
        "Content-Type": "application/offset+octet-stream",
        "Content-Length": str(length),
    }
    response = connection.request("PATCH", address, content=_bytes_of(path, offset, length), headers=headers)
    return int(response.headers["Upload-Offset"])


def _bytes_of(path: Path, offset: int, length: int) -> Iterator[bytes]:
    with path.open("rb") as file:
        file.seek(offset)
        while length > 0 and (block := file.read(min(_BLOCK_BYTES, length))):
            length -= len(block)
            yield block
