"""Sites, their files and uploads in the database."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from sqlalchemy import delete, exists, func, select, update
from sqlalchemy.orm import Session

from wibam_core.adapters import records
from wibam_core.adapters.counters import Counted, count
from wibam_core.adapters.database import Database
from wibam_core.adapters.models import FileRow, JobFileRow, JobRow, SiteRow, UploadRow
from wibam_core.adapters.paging import EVER, Place, Span, newest_first
from wibam_core.adapters.site_rules import (
    camera_of,
    check_camera,
    check_listed,
    check_quota,
    check_size,
    retire_unlisted,
)
from wibam_core.errors import ChangedMeanwhile, Conflict, InputError, NotFound
from wibam_core.jobs.records import Purpose, SiteRecord, StoredFile, Upload
from wibam_core.jobs.states import JobState
from wibam_core.site import Site

#: Files that networks are run on, that become networks, and pictures of the site.
_NOT_FOR_JOBS = (Purpose.FOOTAGE, Purpose.MODEL, Purpose.MAP)
_TERMINAL = [state.value for state in JobState if state.is_terminal]
Clock = Callable[[], float]


@dataclass(frozen=True)
class UploadRequest:
    """A file that a client wants to send: ``length`` bytes, called ``filename`` over there.

    ``metadata`` is what the client said about it, word by word; it gets it back. ``started_ns`` is when the first frame
    of a recording was taken, Unix time.
    """

    site_id: str
    purpose: Purpose
    camera_id: str
    filename: str
    length: int
    metadata: str = ""
    started_ns: int | None = None

    def __post_init__(self) -> None:
        if self.length <= 0:
            raise InputError("the file is empty", hint="Send a file that holds something.")


class SiteStore:
    """Everything a user has given us, but for the bytes themselves.

    Args:
        database: migrated.
        now: Unix seconds.
    """

    def __init__(self, database: Database, now: Clock = time.time) -> None:
        self._database = database
        self._now = now

    # --- sites ---------------------------------------------------------------------------------
    def add_site(self, site: Site) -> SiteRecord:
        record = SiteRecord(records.new_id("site"), site, self._now())
        with self._database.writing() as session:
            session.add(SiteRow(id=record.id, document=site.model_dump_json(), created_at=record.created_at))
        return record

    def sites(
        self, limit: int | None = None, *, text: str = "", made: Span = EVER, after: Place | None = None
    ) -> list[SiteRecord]:
        """Sites, the newest first.

        Args:
            limit: how many at most; None: all.
            text: that the name or the id contains, whatever the case of its letters.
            made: when they were described first.
            after: only those that follow this place in the list.
        """
        wanted = newest_first(select(SiteRow).where(*made.holds(SiteRow.created_at)), SiteRow, None, after)
        found: list[SiteRecord] = []
        with self._database.reading() as session:
            for row in session.scalars(wanted):  # names are inside the documents, which differ in form by database
                record = records.site_record(row)
                if text.casefold() in record.site.name.casefold() or text in record.id:
                    found.append(record)
                if len(found) == limit:
                    break
        return found

    def site(self, site_id: str) -> SiteRecord:
        """Raises:
        NotFound: there is no such site.
        """
        with self._database.reading() as session:
            return records.site_record(_site_row(session, site_id))

    def replace_site(self, site_id: str, site: Site, made_from: str | None = None) -> SiteRecord:
        """Describe a site anew. Jobs keep the description that they were created with.

        Files stay, but for those of cameras that the site no longer has, or no longer lists: they are taken off it,
        and their unfinished uploads are forgotten.

        Args:
            site_id: which.
            site: its new description.
            made_from: the version that it was made from; None: whatever is there is replaced.

        Raises:
            NotFound: there is no such site.
            ChangedMeanwhile: the site is neither of that version nor as described here; nothing was changed.
        """
        gone = (UploadRow.camera_id != "") & UploadRow.camera_id.not_in(site.camera_ids)
        retired = (FileRow.camera_id != "") & FileRow.camera_id.not_in(site.camera_ids) & FileRow.retired_at.is_(None)
        with self._database.writing(exclusive=True) as session:
            row = _site_row(session, site_id)
            there = records.site_record(row)
            if made_from not in (None, there.version) and there.site != site:  # the same may be sent again
                raise ChangedMeanwhile("somebody else has changed the site meanwhile", version=there.version)
            row.document = site.model_dump_json()
            session.execute(delete(UploadRow).where(UploadRow.site_id == site_id, UploadRow.file_id.is_(None), gone))
            session.execute(update(FileRow).where(FileRow.site_id == site_id, retired).values(retired_at=self._now()))
            for camera in site.cameras:
                retire_unlisted(session, site_id, camera, self._now())
            session.flush()
            return records.site_record(row)

    def delete_site(self, site_id: str) -> list[str]:
        """Forget a site with its files and uploads; returns the ids of the files whose bytes may go.

        Raises:
            NotFound: there is no such site.
            Conflict: the site still has jobs.
        """
        with self._database.writing(exclusive=True) as session:
            row = _site_row(session, site_id)
            jobs = session.scalar(select(func.count()).select_from(JobRow).where(JobRow.site_id == site_id)) or 0
            if jobs:
                raise Conflict(
                    f"site {site_id} still has {jobs} job{'s' if jobs > 1 else ''}",
                    hint="Delete its jobs first; their results go with them.",
                    jobs=jobs,
                )
            ids = [*session.scalars(select(FileRow.id).where(FileRow.site_id == site_id))]
            ids += session.scalars(select(UploadRow.id).where(UploadRow.site_id == site_id))
            session.delete(row)
            return ids

    # --- files ---------------------------------------------------------------------------------
    def files(self, site_id: str) -> list[StoredFile]:
        """The current files of a site that jobs work on: recordings by camera and name, labels, detector, network.

        Raises:
            NotFound: there is no such site.
        """
        return [file for file in self.all_files(site_id) if file.purpose not in _NOT_FOR_JOBS]

    def footage(self, site_id: str) -> list[StoredFile]:
        """All footage of a site's cameras that networks can be run on, the recordings included, by camera and name.

        Raises:
            NotFound: there is no such site.
        """
        return [file for file in self.all_files(site_id) if file.purpose.is_of_camera]

    def all_files(self, site_id: str) -> list[StoredFile]:
        """All current files of a site.

        Raises:
            NotFound: there is no such site.
        """
        with self._database.reading() as session:
            _site_row(session, site_id)
            return _current_files(session, site_id)

    def retire_file(self, site_id: str, file_id: str) -> None:
        """Take a file off its site. Jobs that were made with it keep it.

        Raises:
            NotFound: the site has no such file.
        """
        with self._database.writing() as session:
            row = session.get(FileRow, file_id)
            if row is None or row.site_id != site_id or row.retired_at is not None:
                raise NotFound(f"site {site_id} has no file {file_id}", hint="List its recordings to see their ids.")
            row.retired_at = self._now()

    def date_file(self, site_id: str, file_id: str, started_ns: int | None) -> StoredFile:
        """Say when a recording or footage began, Unix time.

        Jobs that were made with the file go on as they are: what they have made stays.

        Raises:
            NotFound: the site has no such file.
            InputError: it is no recording.
            Conflict: a job works with it, that has not ended.
        """
        with self._database.writing(exclusive=True) as session:
            row = session.get(FileRow, file_id)
            if row is None or row.site_id != site_id or row.retired_at is not None:
                raise NotFound(f"site {site_id} has no file {file_id}", hint="List its footage to see the ids.")
            if not Purpose(row.purpose).is_of_camera:
                raise InputError(f"a file for {row.purpose} has no time when it began", hint="Name a recording.")
            using = session.scalar(
                select(JobFileRow.job_id)
                .join(JobRow, JobRow.id == JobFileRow.job_id)
                .where(JobFileRow.file_id == file_id, JobRow.state.not_in(_TERMINAL))
                .limit(1)
            )
            if using is not None:
                raise Conflict(f"job {using} works with the file", hint="Wait until it has ended.", job=using)
            row.started_ns = started_ns
            session.flush()
            return records.stored_file(row)

    def purge_files(self) -> list[str]:
        """Forget retired files that no job needs; returns their ids."""
        unused = (FileRow.retired_at.is_not(None)) & ~exists().where(JobFileRow.file_id == FileRow.id)
        with self._database.writing(exclusive=True) as session:
            return [*session.scalars(delete(FileRow).where(unused).returning(FileRow.id))]

    # --- uploads -------------------------------------------------------------------------------
    def add_upload(self, request: UploadRequest, *, lifetime_s: float, quota_bytes: int) -> Upload:
        """Admit an upload.

        Args:
            request: what is to come.
            lifetime_s: how long it is kept without news.
            quota_bytes: all finished files and promised uploads together may take this much.

        Raises:
            NotFound: there is no such site.
            InputError: the site has no such camera, or the purpose takes none.
            QuotaExceeded: too much is stored already.
            TooLarge: no file for this purpose is so large.
        """
        now = self._now()
        upload = Upload(
            id=records.new_id("file"),
            site_id=request.site_id,
            purpose=request.purpose,
            camera_id=request.camera_id,
            filename=records.plain_text(request.filename)[:255],
            length=request.length,
            offset=0,
            created_at=now,
            expires_at=now + lifetime_s,
            started_ns=request.started_ns,
        )
        with self._database.writing(exclusive=True) as session:
            site = records.site_record(_site_row(session, request.site_id)).site
            check_camera(site, request.purpose, request.camera_id)
            if request.purpose is Purpose.RECORDING:
                check_listed(camera_of(site, request.camera_id), upload.filename)
            check_size(request.purpose, request.length)
            check_quota(session, request.length, quota_bytes)
            session.add(
                UploadRow(
                    id=upload.id,
                    site_id=upload.site_id,
                    purpose=upload.purpose.value,
                    camera_id=upload.camera_id,
                    filename=upload.filename,
                    length_bytes=upload.length,
                    offset_bytes=0,
                    created_at=now,
                    expires_at=upload.expires_at,
                    given_metadata=request.metadata,
                    started_ns=request.started_ns,
                )
            )
        return upload

    def upload(self, upload_id: str) -> Upload:
        """Raises:
        NotFound: there is no such upload (any more).
        """
        with self._database.reading() as session:
            row = session.get(UploadRow, upload_id)
            if row is None:
                raise NotFound(f"there is no upload {upload_id}", hint="It may have expired; start a new one.")
            return records.upload(row)

    def upload_metadata(self, upload_id: str) -> str:
        """What the client said about an upload, word by word; empty where there is no such upload."""
        with self._database.reading() as session:
            row = session.get(UploadRow, upload_id)
            return row.given_metadata if row is not None else ""

    def advance_upload(self, upload_id: str, offset: int, *, lifetime_s: float) -> None:
        """Acknowledge bytes that are safely on disk, and keep the upload for another ``lifetime_s``."""
        values = {"offset_bytes": offset, "expires_at": self._now() + lifetime_s}
        with self._database.writing() as session:
            _count_received(session, upload_id, offset)
            session.execute(update(UploadRow).where(UploadRow.id == upload_id).values(values))

    def complete_upload(self, upload: Upload, *, suffix: str, sha256: str) -> StoredFile:
        """All bytes are there: the upload becomes the current file of its purpose and camera; both have one id.

        Of a camera whose recording is of several files it takes the place of the one of its name alone.

        Raises:
            NotFound: the upload is gone: its site, or its camera, was deleted meanwhile.
        """
        now = self._now()
        file = StoredFile(
            upload.id,
            upload.site_id,
            upload.purpose,
            upload.camera_id,
            upload.filename,
            suffix,
            upload.length,
            sha256,
            now,
            upload.started_ns,
        )
        same_place = (
            (FileRow.site_id == file.site_id)
            & (FileRow.purpose == file.purpose.value)
            & (FileRow.camera_id == file.camera_id)
            & FileRow.retired_at.is_(None)
        )
        with self._database.writing(exclusive=True) as session:
            if session.get(UploadRow, upload.id) is None:
                raise NotFound(f"there is no upload {upload.id} any more", hint="Start a new one.")
            _count_received(session, upload.id, upload.length)
            camera = camera_of(records.site_record(_site_row(session, file.site_id)).site, file.camera_id)
            if file.purpose in (Purpose.FOOTAGE, Purpose.MODEL) or (camera is not None and camera.recordings):
                same_place &= FileRow.filename == file.filename
            session.execute(update(FileRow).where(same_place).values(retired_at=now))
            session.add(
                FileRow(
                    id=file.id,
                    site_id=file.site_id,
                    purpose=file.purpose.value,
                    camera_id=file.camera_id,
                    filename=file.filename,
                    suffix=suffix,
                    size_bytes=file.size_bytes,
                    sha256=sha256,
                    created_at=now,
                    started_ns=file.started_ns,
                )
            )
            done = {"offset_bytes": upload.length, "file_id": file.id}
            session.execute(update(UploadRow).where(UploadRow.id == upload.id).values(done))
        return file

    def delete_upload(self, upload_id: str) -> None:
        """Forget an upload; the file it became, if any, stays."""
        with self._database.writing() as session:
            session.execute(delete(UploadRow).where(UploadRow.id == upload_id))

    def known_file_ids(self) -> set[str]:
        """The ids of all uploads and files, retired ones too."""
        with self._database.reading() as session:
            return {*session.scalars(select(FileRow.id)), *session.scalars(select(UploadRow.id))}

    def expired_uploads(self) -> list[Upload]:
        """Uploads whose time is over."""
        with self._database.reading() as session:
            rows = session.scalars(select(UploadRow).where(UploadRow.expires_at < self._now()))
            return [records.upload(row) for row in rows]


def _current_files(session: Session, site_id: str) -> list[StoredFile]:
    rows = session.scalars(
        select(FileRow)
        .where(FileRow.site_id == site_id, FileRow.retired_at.is_(None))
        .order_by(FileRow.purpose, FileRow.camera_id, FileRow.filename)
    )
    return [records.stored_file(row) for row in rows]


def _site_row(session: Session, site_id: str) -> SiteRow:
    row = session.get(SiteRow, site_id)
    if row is None:
        raise NotFound(f"there is no site {site_id}", hint="List the sites to see their ids.")
    return row


def _count_received(session: Session, upload_id: str, offset: int) -> None:
    before = session.scalar(select(UploadRow.offset_bytes).where(UploadRow.id == upload_id))
    if before is not None and offset > before:
        count(session, Counted.UPLOADED_BYTES, float(offset - before))
