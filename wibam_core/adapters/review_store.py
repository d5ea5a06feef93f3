"""What people say of conflicts, in the database."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from sqlalchemy import select

from wibam_core.adapters import records
from wibam_core.adapters.database import Database
from wibam_core.adapters.job_rows import job_row
from wibam_core.adapters.models import ConflictReviewRow


class Verdict(StrEnum):
    """Whether somebody who has looked takes a conflict for one."""

    CONFIRMED = "confirmed"
    REJECTED = "rejected"


@dataclass(frozen=True)
class ConflictReview:
    """What somebody says of a conflict; ``reviewed_at`` in Unix seconds."""

    conflict_id: int
    verdict: Verdict
    note: str
    reviewed_at: float


class ReviewStore:
    """Reviews belong to a job and to the outputs of its safety stage: conflicts of other outputs are others.

    Args:
        database: migrated.
        now: Unix seconds.
    """

    def __init__(self, database: Database, now: Callable[[], float] = time.time) -> None:
        self._database = database
        self._now = now

    def reviews(self, job_id: str, hash: str) -> list[ConflictReview]:
        """All reviews of these outputs, by conflict.

        Raises:
            NotFound: there is no such job.
        """
        mine = (ConflictReviewRow.job_id == job_id) & (ConflictReviewRow.hash == hash)
        with self._database.reading() as session:
            job_row(session, job_id)
            rows = session.scalars(select(ConflictReviewRow).where(mine).order_by(ConflictReviewRow.conflict_id))
            return [ConflictReview(row.conflict_id, Verdict(row.verdict), row.note, row.reviewed_at) for row in rows]

    def say(self, job_id: str, hash: str, conflict_id: int, verdict: Verdict, note: str) -> ConflictReview:
        """Say something of a conflict, in place of what was said before.

        Raises:
            NotFound: there is no such job.
        """
        review = ConflictReview(conflict_id, verdict, records.plain_text(note), self._now())
        with self._database.writing() as session:
            job_row(session, job_id, lock=True)
            row = session.get(ConflictReviewRow, (job_id, hash, conflict_id))
            if row is None:
                row = ConflictReviewRow(job_id=job_id, hash=hash, conflict_id=conflict_id)
                session.add(row)
            row.verdict, row.note, row.reviewed_at = verdict.value, review.note, review.reviewed_at
        return review

    def forget(self, job_id: str, hash: str, conflict_id: int) -> None:
        """Take back what was said of a conflict, if anything was.

        Raises:
            NotFound: there is no such job.
        """
        with self._database.writing() as session:
            job_row(session, job_id, lock=True)
            row = session.get(ConflictReviewRow, (job_id, hash, conflict_id))
            if row is not None:
                session.delete(row)
