"""A file whose content is sent on while it is written."""

from __future__ import annotations

import io
from typing import Any


class Outlet(io.RawIOBase):
    """A file to write to whose bytes are taken away now and then. ``len`` is what waits to be taken."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._waiting = 0

    def __len__(self) -> int:
        return self._waiting

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self._parts.append(bytes(data))
        self._waiting += len(data)
        return len(data)

    def take(self) -> bytes:
        """What was written since the last time."""
        data = b"".join(self._parts)
        self._parts.clear()
        self._waiting = 0
        return data
