"""The data folder on the local disk. Every path in it is made from ids of our own, never from a user's names."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import re
import secrets
import shutil
import tempfile
import time
from collections import OrderedDict
from collections.abc import Callable, Collection
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from wibam_core.errors import Conflict, DiskFull, Locked, NotFound
from wibam_core.jobs.records import StoredFile, Upload

_ID = re.compile(r"[a-z]+_[0-9a-f]{16}")
_SPARE_BYTES = 256 * 1024 * 1024  # kept free when an upload is admitted
_HASH_BLOCK = 4 * 1024 * 1024


class DataFolder:
    """Where everything but the database's rows lies.

    ``uploads/`` unfinished uploads, ``files/`` finished ones, ``stages/`` published outputs (`StageStore`),
    ``models/`` a folder a network, ``site-tracks/`` the tables of sites, ``logs/`` one text file a job, ``clips/``
    finished video clips, ``cache/`` what stages may cache, ``workers/`` who is there (`presence`), ``database-id``
    whose folder it is, ``folder-id`` which one, ``secret`` what signs links.
    """

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        self.root.mkdir(mode=0o700, parents=True, exist_ok=True)
        names = ("uploads", "files", "stages", "models", "site-tracks", "logs", "clips", "cache", "workers")
        for folder in names:
            (self.root / folder).mkdir(exist_ok=True)

    @property
    def stages(self) -> Path:
        return self.root / "stages"

    @property
    def cache(self) -> Path:
        return self.root / "cache"

    @property
    def workers(self) -> Path:
        return self.root / "workers"

    def upload(self, upload_id: str) -> Path:
        return self.root / "uploads" / _plain(upload_id)

    def file(self, file: StoredFile) -> Path:
        return self._finished(file.id, file.suffix)

    def log(self, job_id: str) -> Path:
        return self.root / "logs" / f"{_plain(job_id)}.log"

    def clip(self, clip_id: str) -> Path:
        return self.root / "clips" / f"{_plain(clip_id)}.mp4"

    def clip_workspace(self, clip_id: str) -> tempfile.TemporaryDirectory[str]:
        """A folder beside the finished clips for whoever renders one. Where it was killed, `tidy_clips` removes it."""
        folder = self.root / "clips"
        return tempfile.TemporaryDirectory(prefix=f".{_plain(clip_id)}-", dir=folder, ignore_cleanup_errors=True)

    def tidy_clips(self, known: Callable[[], Collection[str]], older_than_s: float = 3600.0) -> None:
        """Remove clips that nobody knows any more, and what killed renderings left.

        Args:
            known: the ids of all clips, asked for once the files are listed.
            older_than_s: what has been written to meanwhile may be a clip that is being made.
        """
        limit = time.time() - older_than_s
        there = [path for path in (self.root / "clips").iterdir() if unchanged_since(path, limit)]
        ids = known()
        for path in there:
            if not path.is_dir():
                if path.stem not in ids:
                    path.unlink(missing_ok=True)
                continue
            files = [Path(folder) / name for folder, _, names in os.walk(path) for name in names]
            if all(unchanged_since(file, limit) for file in files):  # else it is being rendered
                shutil.rmtree(path, ignore_errors=True)

    def model(self, model_id: str) -> Path:
        """The folder of a network: what is in it, `wibam_core.adapters.model_keeping` knows."""
        return self.root / "models" / _plain(model_id)

    def tidy_models(self, known: Callable[[], Collection[str]], older_than_s: float = 3600.0) -> None:
        """Remove the folders of networks that nobody knows, as where keeping one was interrupted.

        Args:
            known: the ids of all networks, asked for once the folders are listed.
            older_than_s: what is younger may be a network that is being kept.
        """
        limit = time.time() - older_than_s
        there = [path for path in (self.root / "models").iterdir() if unchanged_since(path, limit)]
        ids = known()
        for path in there:
            if path.name not in ids:
                shutil.rmtree(path, ignore_errors=True)

    @property
    def site_tracks(self) -> Path:
        return self.root / "site-tracks"

    def require_space(self, size_bytes: int) -> None:
        """Raises:
        DiskFull: ``size_bytes`` more do not fit.
        """
        free = shutil.disk_usage(self.root).free
        if free < size_bytes + _SPARE_BYTES:
            raise DiskFull(
                f"{size_bytes / 1e6:.0f} MB do not fit on the service's disk, {free / 1e6:.0f} MB are free",
                hint="Free space in the data folder, then send the file again.",
                free_bytes=free,
            )

    def remove_file(self, file_id: str) -> None:
        """Remove a finished file and whatever is left of its upload. Absent ones are fine."""
        self.upload(file_id).unlink(missing_ok=True)
        self.upload(file_id).with_suffix(".lock").unlink(missing_ok=True)
        for path in self._all_finished(file_id):
            path.unlink(missing_ok=True)

    def old_file_ids(self, older_than_s: float = 3600.0) -> set[str]:
        """Ids of files and uploads whose bytes have lain here unchanged for a while."""
        limit = time.time() - older_than_s
        paths = [path for name in ("uploads", "files") for path in (self.root / name).iterdir()]
        ids = {path.name.split(".")[0] for path in paths if unchanged_since(path, limit)}
        return {name for name in ids if _ID.fullmatch(name)}

    def holds_bytes(self) -> set[str]:
        """Ids of files and uploads of which something lies here, however new; lock files are nothing."""
        paths = [path for name in ("uploads", "files") for path in (self.root / name).iterdir()]
        return {path.name.split(".")[0] for path in paths if path.suffix != ".lock" and path.stat().st_size}

    def database_id(self) -> str | None:
        """Of the database that knows what lies here; None until one has been told (`belong_to`)."""
        return self._told("database-id")

    def belong_to(self, database_id: str) -> None:
        """Remember the database that knows what lies here."""
        self._remember("database-id", database_id)

    def folder_id(self) -> str | None:
        """What tells this folder from every other, its copies excepted; None until it has been told (`be`)."""
        return self._told("folder-id")

    def be(self, folder_id: str) -> None:
        """Remember which folder this is."""
        self._remember("folder-id", folder_id)

    def secret(self) -> str:
        """What signs links and browsers' passes: known to the service alone, made on first use."""
        path = self.root / "secret"
        if not path.exists():
            partial = self.root / f"secret-{secrets.token_hex(4)}"
            with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
                file.write(secrets.token_urlsafe(32) + "\n")
            with contextlib.suppress(FileExistsError):
                os.link(partial, path)  # of services that start together, the first one's stays
            partial.unlink()
        return path.read_text().strip()

    def _told(self, name: str) -> str | None:
        path = self.root / name
        return path.read_text().strip() if path.exists() else None

    def _remember(self, name: str, text: str) -> None:
        partial = self.root / f"{name}-{secrets.token_hex(4)}"
        partial.write_text(text + "\n")
        partial.replace(self.root / name)

    def remove_log(self, job_id: str) -> None:
        self.log(job_id).unlink(missing_ok=True)

    def finish(self, upload_id: str) -> str:
        """Make a whole upload a finished file of the same id; returns its suffix, told by its first bytes."""
        source = self.upload(upload_id)
        with source.open("rb") as stream:
            suffix = _suffix(stream.read(4))
        source.replace(self._finished(upload_id, suffix))
        return suffix

    def reopen(self, upload_id: str) -> None:
        """Undo `finish` where the service was killed before the database knew of it."""
        for path in self._all_finished(upload_id):
            path.replace(self.upload(upload_id))

    def _finished(self, file_id: str, suffix: str) -> Path:
        return self.root / "files" / f"{_plain(file_id)}{suffix}"

    def _all_finished(self, file_id: str) -> list[Path]:
        return [p for suffix in ("", ".parquet", ".json") if (p := self._finished(file_id, suffix)).exists()]


class UploadFile:
    """The bytes of an unfinished upload, held by one writer at a time. A context manager: inside it, and only there,
    what the database says about the upload stays true.

    Raises:
        Locked: another request is writing to this upload (on entering).
    """

    def __init__(self, folder: DataFolder, upload_id: str) -> None:
        self._path = folder.upload(upload_id)
        self._folder = folder
        self._upload_id = upload_id
        self._lock: BinaryIO | None = None
        self._stream: BinaryIO | None = None

    def __enter__(self) -> Self:
        lock = self._path.with_suffix(".lock").open("ab")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            raise Locked("another request is writing to this upload") from None
        self._lock = lock
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for stream in (self._stream, self._lock):
            if stream is not None:
                stream.close()

    def resume_at(self, offset: int) -> None:
        """Drop what lies beyond ``offset`` (bytes that were written, but not acknowledged) and go on there.

        Raises:
            Conflict: fewer than ``offset`` bytes are there.
        """
        if not self._path.exists():
            self._folder.reopen(self._upload_id)
        self._stream = stream = os.fdopen(os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600), "r+b")
        size = os.fstat(stream.fileno()).st_size
        if size < offset:
            raise Conflict(
                f"the upload has lost bytes on the service's disk: {size} of {offset} are left",
                hint="Delete this upload and start a new one.",
            )
        stream.truncate(offset)
        stream.seek(offset)

    def write(self, data: bytes) -> None:
        """Raises:
        DiskFull: the disk is full.
        """
        try:
            self._open_stream.write(data)
        except OSError as error:
            raise DiskFull("the service's disk is full", hint="Free space, then resume the upload.") from error

    def sync(self) -> None:
        """Return once everything written so far would survive a power cut.

        Raises:
            DiskFull: the disk is full.
        """
        try:
            self._open_stream.flush()
            os.fdatasync(self._open_stream.fileno())
        except OSError as error:
            raise DiskFull("the service's disk is full", hint="Free space, then resume the upload.") from error

    def read_sha256(self) -> str:
        """The digest of everything that is in the file, by reading it."""
        digest = hashlib.sha256()
        self._open_stream.seek(0)
        while block := self._open_stream.read(_HASH_BLOCK):
            digest.update(block)
        return digest.hexdigest()

    @property
    def _open_stream(self) -> BinaryIO:
        if self._stream is None:
            raise ValueError("the upload is not open")
        return self._stream


class RunningDigests:
    """SHA-256 of unfinished uploads, kept along while their bytes pass, so that finishing one need not read it again.

    Only the last ``capacity`` uploads are kept; an upload whose digest is not at hand is read once, at its end.
    """

    def __init__(self, capacity: int = 64) -> None:
        self._capacity = capacity
        self._kept: OrderedDict[str, tuple[int, hashlib._Hash]] = OrderedDict()

    def take(self, upload: Upload) -> hashlib._Hash | None:
        """The digest of the first ``upload.offset`` bytes, if it is known. It is no longer kept."""
        if upload.offset == 0:
            self._kept.pop(upload.id, None)
            return hashlib.sha256()
        offset, digest = self._kept.pop(upload.id, (-1, None))
        return digest if offset == upload.offset else None

    def keep(self, upload_id: str, offset: int, digest: hashlib._Hash | None) -> None:
        if digest is None:
            return
        self._kept[upload_id] = (offset, digest)
        while len(self._kept) > self._capacity:
            self._kept.popitem(last=False)


def unchanged_since(path: Path, limit: float) -> bool:
    """Whether nobody has written to a file since a time (Unix seconds); False where it is gone."""
    try:
        return path.stat().st_mtime <= limit
    except FileNotFoundError:  # it was removed meanwhile
        return False


def _plain(name: str) -> str:
    if not _ID.fullmatch(name):
        raise NotFound(f"there is nothing with the id {name!r}", hint="Ids are listed by /v1/sites and /v1/jobs.")
    return name


#: What may stand before the first character of JSON: byte-order marks, and the empty byte of a wide one.
_ENCODING_BYTES = b"\xef\xbb\xbf\xff\xfe\0"


def _suffix(head: bytes) -> str:
    if head == b"PAR1":
        return ".parquet"
    first = head.lstrip(_ENCODING_BYTES)[:1]
    return ".json" if first in (b"{", b"[") else ""
