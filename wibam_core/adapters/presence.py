"""Which workers of this host are gone: the lock that each holds on a file of its own ends with its process.

A lease tells of a lost worker once it expires. On one host that is known at once, however the worker ended, and across
containers that share the data folder, too. What another host's workers hold is never judged here, since locks need not
reach from one host to the other: their leases expire.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from wibam_core.adapters.records import new_id

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class Presence:
    """A worker process that is there. A context manager; the lock is held until it ends, or its process does.

    Args:
        folder: where all workers tell that they are there.

    Attributes:
        owner: the name under which the worker takes stages; no two processes ever have the same.
    """

    def __init__(self, folder: Path) -> None:
        self._id = new_id("worker")
        self.owner = f"{socket.gethostname()}:{os.getpid()}:{self._id}"
        self._folder = folder
        self._file: BinaryIO | None = None

    def __enter__(self) -> Self:
        partial = self._folder / f".{self._id}"
        self._file = partial.open("xb", buffering=0)
        self._file.write(json.dumps({"owner": self.owner, "host": host_id()}).encode())
        fcntl.flock(self._file, fcntl.LOCK_EX)
        partial.rename(self._folder / self._id)  # whoever sees it by its name sees it locked
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._file is not None
        (self._folder / self._id).unlink(missing_ok=True)
        self._file.close()


@dataclass(frozen=True)
class Departed:
    """Workers of this host whose processes have ended without a word: `owners` of leases, and their files."""

    owners: frozenset[str]
    files: tuple[Path, ...]

    def forget(self) -> None:
        """Remove their files, once nobody waits for them any more."""
        for file in self.files:
            file.unlink(missing_ok=True)


def departed(folder: Path) -> Departed:
    """The workers of this host that are gone. They cannot come back: a process that starts anew has another name."""
    found = [(path, owner) for path in folder.iterdir() if (owner := _owner_that_is_gone(path)) is not None]
    return Departed(frozenset(owner for _, owner in found), tuple(path for path, _ in found))


def host_id() -> str:
    """Of the running system, the same in all its containers; empty where it does not tell."""
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return ""


def _owner_that_is_gone(path: Path) -> str | None:
    if path.name.startswith("."):
        return None
    with _opened(path) as file:
        if file is None:
            return None
        try:
            told = json.loads(file.read(4096))
        except ValueError:
            return None
        if not host_id() or told.get("host") != host_id():
            return None
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)  # shared: several may look at once
        except OSError:
            return None
        return str(told["owner"])


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[BinaryIO | None]:
    try:
        file = path.open("rb")
    except OSError:  # it was removed meanwhile
        yield None
        return
    with file:
        yield file
