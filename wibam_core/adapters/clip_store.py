"""Clips in the database: ask for one, look, render, delete. Claims work as those of stages do."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Any

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session

from wibam_core.adapters import records
from wibam_core.adapters.database import Database
from wibam_core.adapters.job_rows import job_row
from wibam_core.adapters.lease_store import LostLease
from wibam_core.adapters.models import ClipRow
from wibam_core.adapters.paging import EVER, Place, Span, newest_first
from wibam_core.documents.clips import ClipFacts, ClipSpec
from wibam_core.errors import Conflict, NotFound, StageCrashed, WibamError
from wibam_core.jobs.clips import Clip, ClipClaim, ClipState
from wibam_core.jobs.leases import LeasePolicy

_MOST_OF_A_JOB = 100
_QUEUED, _RUNNING = ClipState.QUEUED.value, ClipState.RUNNING.value


class ClipStore:
    """What users ask for, and what workers do about it.

    Args:
        database: migrated.
        policy: how long leases last.
        now: Unix seconds.
    """

    def __init__(self, database: Database, policy: LeasePolicy, now: Callable[[], float] = time.time) -> None:
        self._database = database
        self._policy = policy
        self._now = now

    # --- users -----------------------------------------------------------------------------------
    def create(self, job_id: str, tracks_hash: str, spec: ClipSpec) -> Clip:
        """Ask for a clip.

        Raises:
            NotFound: there is no such job.
            Conflict: the job has many clips already.
        """
        with self._database.writing() as session:
            job_row(session, job_id, lock=True)
            there = session.scalar(select(func.count()).select_from(ClipRow).where(ClipRow.job_id == job_id)) or 0
            if there >= _MOST_OF_A_JOB:
                raise Conflict(f"job {job_id} has {there} clips", hint="Delete those that you no longer need.")
            row = ClipRow(
                id=records.new_id("clip"),
                job_id=job_id,
                spec=spec.model_dump(mode="json"),
                tracks_hash=tracks_hash,
                state=_QUEUED,
                attempts=0,
                fence=0,
                fraction=0.0,
                message="",
                created_at=self._now(),
                dispatched_at=self._now(),
            )
            session.add(row)
            session.flush()
            return _clip(row)

    def clips(
        self,
        job_id: str,
        limit: int | None = None,
        *,
        states: Collection[ClipState] = (),
        made: Span = EVER,
        after: Place | None = None,
    ) -> list[Clip]:
        """The clips of a job, the newest first.

        Args:
            job_id: whose.
            limit: how many at most; None: all.
            states: in one of these; none: in any.
            made: when they were asked for.
            after: only those that follow this place in the list.

        Raises:
            NotFound: there is no such job.
        """
        wanted = select(ClipRow).where(ClipRow.job_id == job_id, *made.holds(ClipRow.created_at))
        if states:
            wanted = wanted.where(ClipRow.state.in_([state.value for state in states]))
        with self._database.reading() as session:
            job_row(session, job_id)
            return [_clip(row) for row in session.scalars(newest_first(wanted, ClipRow, limit, after))]

    def clip(self, job_id: str, clip_id: str) -> Clip:
        """Raises:
        NotFound: the job has no such clip.
        """
        with self._database.reading() as session:
            return _clip(_row_of(session, job_id, clip_id))

    def delete(self, job_id: str, clip_id: str) -> None:
        """Forget a clip; whoever renders it finds out and stops.

        Raises:
            NotFound: the job has no such clip.
        """
        with self._database.writing() as session:
            session.delete(_row_of(session, job_id, clip_id))

    def ids(self) -> set[str]:
        """Of all clips."""
        with self._database.reading() as session:
            return set(session.scalars(select(ClipRow.id)))

    # --- workers ---------------------------------------------------------------------------------
    def claim(self, clip_id: str, owner: str) -> ClipClaim | None:
        """Take a queued clip, or None: another delivery was faster, or nobody wants it."""
        now = self._now()
        take = (
            update(ClipRow)
            .where(ClipRow.id == clip_id, ClipRow.state == _QUEUED)
            .values(
                state=_RUNNING,
                lease_owner=owner,
                lease_expires_at=now + self._policy.duration_s,
                fence=ClipRow.fence + 1,
                attempts=ClipRow.attempts + 1,
                dispatched_at=None,
                fraction=0.0,
                message="",
            )
            .returning(ClipRow.fence, ClipRow.attempts)
        )
        with self._database.writing() as session:
            taken = session.execute(take).one_or_none()
            row = session.get(ClipRow, clip_id) if taken is not None else None
            return ClipClaim(_clip(row), taken.fence, taken.attempts) if taken is not None and row is not None else None

    def progress(self, claim: ClipClaim, fraction: float, message: str) -> None:
        """Renew the lease, and tell how far it is. Raises:
        LostLease: the clip was deleted, or is another worker's.
        """
        with self._database.writing() as session:
            row = _held(session, claim)
            row.lease_expires_at = self._now() + self._policy.duration_s
            row.fraction, row.message = min(max(fraction, 0.0), 1.0), records.plain_text(message)[:500]

    def succeed(self, claim: ClipClaim, facts: ClipFacts, size_bytes: int, publish: Callable[[], object]) -> None:
        """The clip is done. ``publish`` puts its file into place, and is called only while the lease is held. Raises:
        LostLease: the clip was deleted, or is another worker's.
        """
        with self._database.writing() as session:
            row = _held(session, claim)
            publish()
            row.facts, row.size_bytes, row.fraction, row.error = facts.model_dump(mode="json"), size_bytes, 1.0, None
            self._end(row, ClipState.SUCCEEDED)

    def fail(self, claim: ClipClaim, error: WibamError) -> None:
        """It cannot be rendered. Raises:
        LostLease: the clip was deleted, or is another worker's.
        """
        with self._database.writing() as session:
            row = _held(session, claim)
            row.error = records.plain_json(error.to_dict())
            self._end(row, ClipState.FAILED)

    def release(self, claim: ClipClaim) -> None:
        """The worker is asked to stop: another may take the clip; this attempt does not count. Raises:
        LostLease: the clip was deleted, or is another worker's.
        """
        with self._database.writing() as session:
            row = _held(session, claim)
            row.attempts -= 1
            self._end(row, ClipState.QUEUED)

    def reap(self, *, gone: Collection[str] = (), resend_all: bool = False) -> list[str]:
        """Take back clips of lost workers and find lost messages; returns the clips to dispatch (again).

        Args:
            gone: owners that are known to have ended; of others the lease has to expire.
            resend_all: do not wait to see whether a message got lost: the broker may have been restarted.
        """
        now = self._now()
        patience_s = 0.0 if resend_all else self._policy.resend_s
        with self._database.writing() as session:
            lost = (ClipRow.lease_expires_at < now) | ClipRow.lease_owner.in_(gone)
            late = select(ClipRow).where(ClipRow.state == _RUNNING, lost)
            for row in session.scalars(late.with_for_update()):
                row.fence += 1  # what the lost worker may still write no longer counts
                if row.attempts < self._policy.max_attempts:
                    self._end(row, ClipState.QUEUED)
                    row.dispatched_at = None
                    continue
                failed = StageCrashed(
                    f"the clip lost its worker {row.attempts} times", hint="Try a shorter or smaller one."
                )
                row.error = failed.to_dict()
                self._end(row, ClipState.FAILED)
            session.flush()
            waiting = (ClipRow.dispatched_at <= now - patience_s) | ClipRow.dispatched_at.is_(None)
            again = (
                update(ClipRow).where(ClipRow.state == _QUEUED, waiting).values(dispatched_at=now).returning(ClipRow.id)
            )
            return list(session.scalars(again))

    def _end(self, row: ClipRow, state: ClipState) -> None:
        row.state = state.value
        row.lease_owner = row.lease_expires_at = None
        row.dispatched_at = self._now() if state is ClipState.QUEUED else None
        row.finished_at = self._now() if state.is_terminal else None


def _row_of(session: Session, job_id: str, clip_id: str) -> ClipRow:
    row = session.get(ClipRow, clip_id)
    if row is None or row.job_id != job_id:
        raise NotFound(f"job {job_id} has no clip {clip_id}", hint=f"GET /v1/jobs/{job_id}/clips lists them.")
    return row


def _held(session: Session, claim: ClipClaim) -> ClipRow:
    mine: tuple[Any, ...] = (ClipRow.id == claim.clip.id, ClipRow.fence == claim.fence, ClipRow.state == _RUNNING)
    row = session.scalars(select(ClipRow).where(*mine).with_for_update()).one_or_none()
    if row is None:
        raise LostLease(f"the clip {claim.clip.id} is not this worker's any more")
    return row


def _clip(row: ClipRow) -> Clip:
    return Clip(
        id=row.id,
        job_id=row.job_id,
        spec=ClipSpec.model_validate(row.spec),
        tracks_hash=row.tracks_hash,
        state=ClipState(row.state),
        fraction=row.fraction,
        message=row.message,
        error=row.error,
        facts=None if row.facts is None else ClipFacts.model_validate(row.facts),
        size_bytes=row.size_bytes,
        created_at=row.created_at,
        finished_at=row.finished_at,
    )
