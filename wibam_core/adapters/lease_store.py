"""Claims on stages: who works on what, how it goes and how it ended. The rules are in `wibam_core.jobs.leases`."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, cast

from sqlalchemy import Select, or_, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from wibam_core.adapters import records
from wibam_core.adapters.counters import Counted, count
from wibam_core.adapters.database import Database
from wibam_core.adapters.job_rows import (
    StageKey,
    add_event,
    job_files,
    job_record,
    move_job,
    move_stage,
    settle_job,
    thin_progress,
)
from wibam_core.adapters.machine import this_machine
from wibam_core.adapters.models import JobRow, StageRow
from wibam_core.adapters.naming import in_users_words
from wibam_core.documents.warnings import StageWarning
from wibam_core.errors import StageCrashed, WibamError
from wibam_core.jobs.estimate import pace_of, remaining_s
from wibam_core.jobs.leases import Claim, Heartbeat, LeasePolicy
from wibam_core.jobs.records import EventKind
from wibam_core.jobs.states import JobState, StageState

_WANTED = (JobState.QUEUED.value, JobState.RUNNING.value)
_RUNNING = StageState.RUNNING.value


class LostLease(Exception):
    """The stage was given to another worker, or its job is gone: drop the work."""


class LeaseStore:
    """What workers do to jobs.

    Methods that end a stage return the stages to dispatch next.

    Args:
        database: migrated.
        policy: how long leases last.
        now: Unix seconds. Workers on several machines need clocks that agree within a heartbeat.
    """

    def __init__(self, database: Database, policy: LeasePolicy, now: Callable[[], float] = time.time) -> None:
        self._database = database
        self._policy = policy
        self._now = now

    def claim(self, key: StageKey, owner: str) -> Claim | None:
        """Take a queued stage, or None: another delivery was faster, an equal stage is running, or nobody wants it."""
        now = self._now()
        take = (
            update(StageRow)
            .where(
                StageRow.job_id == key.job_id,
                StageRow.name == key.stage,
                StageRow.state == StageState.QUEUED.value,
                select(JobRow.state).where(JobRow.id == key.job_id).scalar_subquery().in_(_WANTED),
            )
            .values(
                state=_RUNNING,
                lease_owner=owner,
                lease_expires_at=now + self._policy.duration_s,
                fence=StageRow.fence + 1,
                attempts=StageRow.attempts + 1,
                dispatched_at=None,
                started_at=now,
                finished_at=None,
                fraction=0.0,
                message="",
                figures=None,
            )
            .returning(StageRow.fence, StageRow.attempts)
        )
        try:
            with self._database.writing() as session:
                job = session.get(JobRow, key.job_id, with_for_update=True)
                taken = session.execute(take).one_or_none() if job is not None else None
                if job is None or taken is None:
                    return None
                if job.state == JobState.QUEUED.value:
                    move_job(session, job, JobState.RUNNING, now)
                add_event(session, job, EventKind.STAGE, now, stage=key.stage, state=_RUNNING, attempt=taken.attempts)
        except IntegrityError:  # uq_stage_runs_running_hash: the same stage runs for another job
            return None
        return Claim(key.job_id, key.stage, owner, taken.fence, taken.attempts)

    def reusable_hash(self, key: StageKey) -> str | None:
        """The address whose outputs would settle a stage that is due; None where it is not, or is to be made anew."""
        with self._database.reading() as session:
            stage = session.get(StageRow, (key.job_id, key.stage))
            if stage is None or stage.state != StageState.QUEUED.value:
                return None
            return None if session.scalars(_to_be_made_anew(stage.hash).limit(1)).one_or_none() else stage.hash

    def make_way(self, claim: Claim, remove: Callable[[str, str], None]) -> bool:
        """Before the work: if a restarted job wants this stage made anew, remove its old outputs, once.

        Which job's turn it is does not matter: outputs belong to a hash, so whoever comes first makes them for all.

        Args:
            claim: of the stage.
            remove: called with its name and hash, and only while the lease is held.

        Returns:
            Whether anything was removed.

        Raises:
            LostLease: the stage is no longer this worker's; nothing was removed.
        """
        with self._database.writing() as session:
            _, stage = _held_rows(session, claim)
            forced = session.scalars(_to_be_made_anew(stage.hash)).all()
            if forced:
                remove(stage.name, stage.hash)
            for row in forced:
                row.forced = False
            return bool(forced)

    def heartbeat(self, claim: Claim) -> Heartbeat:
        """Renew the lease."""
        renew = update(StageRow).where(*_held(claim)).values(lease_expires_at=self._now() + self._policy.duration_s)
        with self._database.writing() as session:
            if session.execute(renew.returning(StageRow.name)).one_or_none() is None:
                return Heartbeat(held=False, wanted=False)
            state = session.scalar(select(JobRow.state).where(JobRow.id == claim.job_id))
            failed = session.scalar(
                select(StageRow.name)
                .where(StageRow.job_id == claim.job_id, StageRow.state == StageState.FAILED.value)
                .limit(1)
            )
            return Heartbeat(held=True, wanted=state in _WANTED and failed is None)

    def progress(self, claim: Claim, fraction: float, message: str, figures: Mapping[str, float]) -> None:
        """Tell how far the stage is. Raises:
        LostLease: the stage is no longer this worker's.
        """
        with self._database.writing() as session:
            job, stage = _held_rows(session, claim)
            stage.fraction = min(max(fraction, 0.0), 1.0)
            stage.message = records.plain_text(message)[:500]
            stage.figures = records.plain_json(dict(figures)) or None
            now = self._now()
            session.flush()
            whole = job_record(session, job)
            add_event(
                session,
                job,
                EventKind.PROGRESS,
                now,
                stage=stage.name,
                fraction=stage.fraction,
                message=stage.message,
                figures=stage.figures or {},
                job_remaining_s=remaining_s(whole, pace_of(whole, this_machine()), now),
            )

    def succeed(
        self,
        claim: Claim,
        summary: Mapping[str, Any],
        publish: Callable[[], object],
        warnings: Sequence[StageWarning] = (),
        *,
        reused: bool = False,
    ) -> list[StageKey]:
        """The stage is done. ``publish`` makes its outputs visible, and is called only while the lease is held.

        Raises:
            LostLease: the stage is no longer this worker's; nothing was published.
        """
        state = StageState.REUSED if reused else StageState.SUCCEEDED
        with self._database.writing() as session:
            job, stage = _held_rows(session, claim)
            publish()
            stage.summary = records.plain_json(dict(summary))
            stage.warnings = _in_users_words(session, job, warnings)
            stage.error = None
            stage.fraction = 1.0
            return self._end(session, job, stage, state, summary=stage.summary, warnings=stage.warnings)

    def fail(self, claim: Claim, error: WibamError, warnings: Sequence[StageWarning] = ()) -> list[StageKey]:
        """The stage failed. The error, and what it warned of before, are kept in the user's words: see
        `wibam_core.adapters.naming`. Raises:
        LostLease: the stage is no longer this worker's.
        """
        with self._database.writing() as session:
            job, stage = _held_rows(session, claim)
            stage.error = records.plain_json(in_users_words(error.to_dict(), job_files(session, job.id)))
            stage.warnings = _in_users_words(session, job, warnings)
            return self._end(session, job, stage, StageState.FAILED, error=stage.error, warnings=stage.warnings)

    def stopped(self, claim: Claim) -> list[StageKey]:
        """The stage was stopped because its job does not want it any more. Raises:
        LostLease: the stage is no longer this worker's.
        """
        with self._database.writing() as session:
            job, stage = _held_rows(session, claim)
            return self._end(session, job, stage, StageState.CANCELLED)

    def release(self, claim: Claim) -> list[StageKey]:
        """The worker is asked to stop: another may take the stage at once; this attempt does not count. Raises:
        LostLease: the stage is no longer this worker's.
        """
        with self._database.writing() as session:
            job, stage = _held_rows(session, claim)
            stage.attempts -= 1
            return self._end(session, job, stage, StageState.QUEUED)

    def retry(self, claim: Claim, reason: str) -> list[StageKey]:
        """The stage ended through no fault that is known: another attempt follows. Raises:
        LostLease: the stage is no longer this worker's.
        """
        with self._database.writing() as session:
            job, stage = _held_rows(session, claim)
            return self._end(session, job, stage, StageState.QUEUED, reason=reason)

    def reap(self, *, gone: Collection[str] = (), resend_all: bool = False) -> list[StageKey]:
        """Take back the leases that expired or whose owners are gone, and find messages that got lost.

        Args:
            gone: owners whose processes are known to have ended.
            resend_all: do not wait to see whether a message got lost: the broker may have been restarted.

        Returns:
            What to dispatch (again).
        """
        now = self._now()
        patience_s = 0.0 if resend_all else self._policy.resend_s
        lost = select(StageRow.job_id, StageRow.name).where(
            StageRow.state == _RUNNING, or_(StageRow.lease_expires_at < now, StageRow.lease_owner.in_(gone))
        )
        with self._database.reading() as session:
            found = [StageKey(job_id, name) for job_id, name in session.execute(lost)]
        again = [following for key in found for following in self._take_back(key, gone)]
        forgotten = (
            update(StageRow)
            .where(StageRow.state == StageState.QUEUED.value, StageRow.dispatched_at <= now - patience_s)
            .values(dispatched_at=now)
            .returning(StageRow.job_id, StageRow.name)
        )
        with self._database.writing() as session:
            again += [StageKey(job_id, name) for job_id, name in session.execute(forgotten)]
        return again

    def running_hashes(self) -> set[str]:
        """The addresses of all outputs that somebody is making right now."""
        with self._database.reading() as session:
            return set(session.scalars(select(StageRow.hash).where(StageRow.state == _RUNNING)))

    def _take_back(self, key: StageKey, gone: Collection[str]) -> list[StageKey]:
        now = self._now()
        with self._database.writing() as session:
            job = session.get(JobRow, key.job_id, with_for_update=True)
            stage = session.get(StageRow, (key.job_id, key.stage), with_for_update=True)
            if job is None or stage is None or stage.state != _RUNNING:
                return []
            if (stage.lease_expires_at or 0.0) >= now and stage.lease_owner not in gone:
                return []
            stage.fence += 1  # what the lost worker may still write no longer counts
            count(session, Counted.LEASE_LOSSES, stage=stage.name)
            if job.state == JobState.CANCELLING.value:
                return self._end(session, job, stage, StageState.CANCELLED)
            state = self._policy.after_expiry(stage.attempts)
            if state is StageState.QUEUED:
                return self._end(session, job, stage, state, reason="its worker was lost")
            error = StageCrashed(
                f"the stage {stage.name} lost its worker in attempt {stage.attempts}, the last",
                hint="It may need more memory or disk than there is; look at the job's log, then restart the job.",
                attempts=stage.attempts,
            )
            stage.error = error.to_dict()
            return self._end(session, job, stage, state, error=stage.error)

    def _end(self, session: Session, job: JobRow, stage: StageRow, state: StageState, **news: Any) -> list[StageKey]:
        now = self._now()
        if state is not StageState.REUSED and stage.started_at is not None:
            outcome = "retried" if state is StageState.QUEUED else state.value
            count(session, Counted.ATTEMPTS, stage=stage.name, outcome=outcome)
            count(session, Counted.SECONDS, max(now - stage.started_at, 0.0), stage=stage.name, outcome=outcome)
        move_stage(session, job, stage, state, now, **news)
        session.flush()
        if state.is_terminal:
            thin_progress(session, job, stage.name)
        own = [StageKey(job.id, stage.name)] if state is StageState.QUEUED else []
        waiting_for_equal = select(StageRow.job_id, StageRow.name).where(
            StageRow.hash == stage.hash, StageRow.state == StageState.QUEUED.value, StageRow.job_id != job.id
        )
        others = [StageKey(job_id, name) for job_id, name in session.execute(waiting_for_equal)]
        return own + settle_job(session, job, now) + others


def _in_users_words(session: Session, job: JobRow, warnings: Sequence[StageWarning]) -> list[dict[str, Any]]:
    found = [warning.model_dump(mode="json") for warning in warnings]
    return cast(list[dict[str, Any]], records.plain_json(in_users_words(found, job_files(session, job.id))))


def _to_be_made_anew(hash: str) -> Select[StageRow]:
    """Stages with this address whose outputs a restarted job wants made anew."""
    wanted_jobs = select(JobRow.id).where(JobRow.state.in_(_WANTED))
    return select(StageRow).where(StageRow.hash == hash, StageRow.forced, StageRow.job_id.in_(wanted_jobs))


def _held(claim: Claim) -> tuple[Any, ...]:
    return (
        StageRow.job_id == claim.job_id,
        StageRow.name == claim.stage,
        StageRow.fence == claim.fence,
        StageRow.state == _RUNNING,
    )


def _held_rows(session: Session, claim: Claim) -> tuple[JobRow, StageRow]:
    job = session.get(JobRow, claim.job_id, with_for_update=True)
    stage = session.scalars(select(StageRow).where(*_held(claim)).with_for_update()).one_or_none()
    if job is None or stage is None:
        raise LostLease(f"{claim.owner} no longer holds {claim.stage} of {claim.job_id}")
    return job, stage
