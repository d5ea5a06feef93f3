"""Receiving files piece by piece: what tus needs, without HTTP.

A byte is acknowledged (counts towards the upload's offset) only once it is safely on disk; whatever lies beyond the
acknowledged offset is dropped when the upload goes on. A killed service therefore never yields a damaged file.
"""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from wibam_core.adapters.files import DataFolder, RunningDigests, UploadFile
from wibam_core.adapters.site_store import SiteStore, UploadRequest
from wibam_core.errors import (
    ChecksumMismatch,
    Conflict,
    Locked,
    NotFound,
    TooLarge,
    UnknownChecksum,
    UploadExpired,
)
from wibam_core.jobs.records import Upload

_ACKNOWLEDGE_EVERY = 16 * 1024 * 1024
CHECKSUMS = ("sha1", "sha256")


class Checksum:
    """What a client says its piece hashes to.

    Raises:
        UnknownChecksum: of an algorithm that we do not know.
    """

    def __init__(self, algorithm: str, expected: bytes) -> None:
        if algorithm not in CHECKSUMS:
            raise UnknownChecksum(f"no checksum algorithm {algorithm!r}", hint=f"Use one of {', '.join(CHECKSUMS)}.")
        self._digest = hashlib.new(algorithm, usedforsecurity=False)
        self._expected = expected

    def update(self, data: bytes) -> None:
        self._digest.update(data)

    def verify(self) -> None:
        """Raises:
        ChecksumMismatch: the bytes were other ones.
        """
        if self._digest.digest() != self._expected:
            raise ChecksumMismatch(f"the {self._digest.name} of this piece is not what it was announced to be")


class UploadService:
    """Creates, continues and drops uploads.

    Args:
        sites: where uploads are remembered.
        folder: where bytes lie.
        quota_bytes: for all uploads together.
        lifetime_s: unfinished uploads are dropped without news.
        now: Unix seconds.
    """

    def __init__(
        self,
        sites: SiteStore,
        folder: DataFolder,
        *,
        quota_bytes: int,
        lifetime_s: float,
        now: Callable[[], float] = time.time,
    ) -> None:
        self.sites = sites
        self.folder = folder
        self.lifetime_s = lifetime_s
        self.quota_bytes = quota_bytes
        self.digests = RunningDigests()
        self.now = now

    def create(self, request: UploadRequest) -> Upload:
        """Admit an upload.

        Raises:
            NotFound: there is no such site.
            InputError: the site has no such camera.
            QuotaExceeded: too much is stored already.
            DiskFull: it would not fit on the disk.
        """
        self.folder.require_space(request.length)
        upload = self.sites.add_upload(request, lifetime_s=self.lifetime_s, quota_bytes=self.quota_bytes)
        self.folder.upload(upload.id).touch(mode=0o600)
        return upload

    def upload(self, upload_id: str) -> Upload:
        """Raises:
        NotFound: there is no such upload.
        UploadExpired: its time is over.
        """
        upload = self.sites.upload(upload_id)
        if upload.expires_at < self.now() and upload.file_id is None:
            raise UploadExpired(f"upload {upload_id} has expired")
        return upload

    def piece(self, upload_id: str, offset: int, checksum: Checksum | None = None) -> Piece:
        """Continue an upload at ``offset``; enter the result to begin."""
        return Piece(self, upload_id, offset, checksum)

    def delete(self, upload_id: str) -> None:
        """Drop an upload; the file that a complete one became stays.

        Raises:
            NotFound: there is no such upload.
            Locked: somebody is writing to it.
        """
        self._drop(upload_id, lambda upload: True)

    def tidy(self) -> None:
        """Drop expired uploads, the bytes of files that nobody needs any more, and bytes that nobody knows of.

        Only for a folder that is known to belong to this database (`claim_folder`).
        """
        for expired in self.sites.expired_uploads():
            with contextlib.suppress(Locked, NotFound):
                self._drop(expired.id, lambda upload: upload.expires_at < self.now())
        for file_id in self.sites.purge_files():
            self.folder.remove_file(file_id)
        for file_id in self.folder.old_file_ids() - self.sites.known_file_ids():
            self.folder.remove_file(file_id)

    def _drop(self, upload_id: str, unwanted: Callable[[Upload], bool]) -> None:
        self.sites.upload(upload_id)  # leaves no lock file behind for an upload that does not exist
        with UploadFile(self.folder, upload_id):
            upload = self.sites.upload(upload_id)  # whoever held the lock may have advanced or completed it
            if not unwanted(upload):
                return
            self.sites.delete_upload(upload_id)
            if upload.file_id is None:
                self.folder.remove_file(upload_id)


class Piece:
    """The bytes of one request, appended to an upload. A context manager that holds the upload's lock.

    Leaving it acknowledges everything that was written, even after an error of the client's connection. With a
    checksum, all or nothing is acknowledged.

    Attributes:
        upload: as it stands after the latest acknowledgement.
    """

    def __init__(self, service: UploadService, upload_id: str, offset: int, checksum: Checksum | None) -> None:
        self._service = service
        self._file = UploadFile(service.folder, upload_id)
        self._id = upload_id
        self._asked_offset = offset
        self._checksum = checksum
        self._digest: hashlib._Hash | None = None

    def __enter__(self) -> Self:
        """Raises:
        NotFound, UploadExpired: the upload is gone.
        Locked: another request is writing to it.
        Conflict: it is complete, or stands at another offset.
        """
        self._service.upload(self._id)
        self._file.__enter__()
        try:
            self.upload = upload = self._service.upload(self._id)
            if upload.offset != self._asked_offset:
                raise Conflict(
                    f"the upload stands at byte {upload.offset}, not {self._asked_offset}",
                    hint="Ask for the offset with HEAD and go on there.",
                    offset=upload.offset,
                )
            if upload.file_id is None:
                self._file.resume_at(upload.offset)
                self._digest = self._service.digests.take(upload)
        except BaseException:
            self._file.__exit__(None, None, None)
            raise
        self._position = self.upload.offset
        return self

    def write(self, data: bytes) -> None:
        """Append bytes.

        Raises:
            TooLarge: more than was promised.
            DiskFull: the disk is full.
        """
        if not data:
            return
        if self._position + len(data) > self.upload.length:
            raise TooLarge(
                f"more bytes than the {self.upload.length} that were promised",
                hint="The file changed while it was being sent? Start a new upload.",
            )
        self._file.write(data)
        self._position += len(data)
        if self._digest is not None:
            self._digest.update(data)
        if self._checksum is not None:
            self._checksum.update(data)
        elif self._position - self.upload.offset >= _ACKNOWLEDGE_EVERY:
            self._acknowledge()

    def finish(self) -> Upload:
        """The request has ended well: acknowledge, and complete the upload if this was its last piece.

        Raises:
            ChecksumMismatch: the piece was damaged; nothing of it is kept.
        """
        if self._checksum is not None:
            self._checksum.verify()
        self._acknowledge()
        return self.upload

    def interrupted(self) -> None:
        """The connection broke: keep what arrived, unless only the whole piece can be verified."""
        if self._checksum is None:
            self._acknowledge()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._position == self.upload.offset and self.upload.file_id is None:
            self._service.digests.keep(self._id, self._position, self._digest)
        self._file.__exit__(kind, error, trace)

    def _acknowledge(self) -> None:
        if self._position == self.upload.offset:
            return
        self._file.sync()
        sites = self._service.sites
        if self._position == self.upload.length:
            sha256 = self._digest.hexdigest() if self._digest is not None else self._file.read_sha256()
            suffix = self._service.folder.finish(self._id)
            sites.complete_upload(self.upload, suffix=suffix, sha256=sha256)
        else:
            sites.advance_upload(self._id, self._position, lifetime_s=self._service.lifetime_s)
        self.upload = sites.upload(self._id)
