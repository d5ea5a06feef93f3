"""One log file a job: what its stages print, and what the worker did about them. Served by offset."""

from __future__ import annotations

import contextlib
import logging
import time
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

_LONGEST_LINE = 4000
_log = logging.getLogger(__name__)


class JobLog:
    """Appends lines to a job's log. A context manager. Past ``max_bytes`` it says so once and drops the rest.

    A log that cannot be opened is none: the work goes on without.
    """

    def __init__(self, path: Path, max_bytes: int = 20_000_000) -> None:
        self._path = path
        self._max_bytes = max_bytes
        self._file: BinaryIO | None = None
        self._full = False

    def __enter__(self) -> Self:
        try:
            self._file = self._path.open("ab", buffering=0)
        except OSError as error:
            _log.warning("there is no log: %s", error)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()

    def write(self, stage: str, text: str) -> None:
        """Append one line, marked with the time (UTC) and the stage. A full disk loses the line, not the work."""
        if self._file is None or self._full:
            return
        if self._file.tell() > self._max_bytes:
            self._full = True
            text = f"the log has reached {self._max_bytes / 1e6:.0f} MB; what follows is not kept"
        stamp = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        with contextlib.suppress(OSError):
            self._file.write(f"{stamp} [{stage}] {text[:_LONGEST_LINE]}\n".encode("utf-8", "replace"))


def read_log(path: Path, offset: int, limit: int = 1_000_000) -> tuple[str, int]:
    """The log from byte ``offset`` on, whole lines where possible, and the offset to go on at."""
    if not path.exists():
        return "", 0
    with path.open("rb") as file:
        file.seek(offset)
        data = file.read(limit)
    if len(data) == limit and (end := data.rfind(b"\n")) >= 0:
        data = data[: end + 1]
    return data.decode("utf-8", "replace"), offset + len(data)
