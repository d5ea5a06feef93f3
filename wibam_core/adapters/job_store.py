"""Jobs in the database: create, look at, cancel, restart, delete, follow."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import delete, or_, select
from sqlalchemy.orm import Session

from wibam_core.adapters import records
from wibam_core.adapters.database import Database
from wibam_core.adapters.job_rows import (
    StageKey,
    add_event,
    add_tags,
    apply,
    job_record,
    job_records,
    job_row,
    nodes,
    settle_job,
    stage_rows,
)
from wibam_core.adapters.model_store import model_row
from wibam_core.adapters.models import EventRow, FileRow, JobFileRow, JobRow, JobTagRow, SiteRow, StageRow
from wibam_core.adapters.paging import EVER, Place, Span, newest_first
from wibam_core.adapters.planning import made_anew
from wibam_core.errors import Conflict, NotFound
from wibam_core.job_kind import JobKind
from wibam_core.jobs.machine import cancel, check_job_move
from wibam_core.jobs.records import Event, EventKind, Job, SiteRecord, StoredFile
from wibam_core.jobs.states import JobState, StageState
from wibam_core.stages.graph import PlannedStage

_TERMINAL = [state.value for state in JobState if state.is_terminal]


@dataclass(frozen=True)
class RunOf:
    """Which network a run uses, and which run it goes on with."""

    model_id: str
    continues: str | None = None


class JobStore:
    """What users do to jobs.

    Args:
        database: migrated.
        now: Unix seconds.
    """

    def __init__(self, database: Database, now: Callable[[], float] = time.time) -> None:
        self._database = database
        self._now = now

    def create(
        self,
        site: SiteRecord,
        options: Mapping[str, Any],
        files: Sequence[StoredFile],
        plan: Sequence[PlannedStage],
        idempotency_key: str | None = None,
        name: str = "",
        run: RunOf | None = None,
        tags: Collection[str] = (),
    ) -> tuple[Job, list[StageKey]]:
        """A new job, and the stages to dispatch; with a key that was used before, the job it made, and nothing.

        It is a run of a network where ``run`` says so.

        Raises:
            NotFound: the site is gone.
            Conflict: the key was used for other options, or a file was deleted meanwhile.
        """
        now = self._now()
        with self._database.writing(exclusive=True) as session:
            if session.get(SiteRow, site.id) is None:
                raise NotFound(f"there is no site {site.id}", hint="List the sites to see their ids.")
            if idempotency_key is not None:
                before = _job_of_key(session, site.id, idempotency_key, options)
                if before is not None:
                    return before, []
            _check_files_exist(session, files)
            row = JobRow(
                id=records.new_id("job"),
                site_id=site.id,
                site_document=site.site.model_dump_json(),
                options=dict(options),
                state=JobState.QUEUED.value,
                created_at=now,
                restarts=0,
                last_event=0,
                idempotency_key=idempotency_key,
                name=records.plain_text(name),
                kind=(JobKind.TRAINING if run is None else JobKind.RUN).value,
                model_id=None if run is None else run.model_id,
                continues=None if run is None else run.continues,
            )
            if run is not None:
                model_row(session, run.model_id)
            session.add(row)
            session.flush()
            session.add_all(JobFileRow(job_id=row.id, file_id=file.id) for file in files)
            add_tags(session, row.id, tags)
            session.add_all(_fresh_stage(row.id, position, planned) for position, planned in enumerate(plan))
            add_event(session, row, EventKind.JOB, now, state=row.state)
            session.flush()
            ready = settle_job(session, row, now)
            session.flush()
            return job_record(session, row), ready

    def job(self, job_id: str) -> Job:
        """Raises:
        NotFound: there is no such job.
        """
        with self._database.reading() as session:
            return job_record(session, job_row(session, job_id))

    def jobs(
        self,
        site_id: str | None = None,
        limit: int = 100,
        *,
        states: Collection[JobState] = (),
        text: str = "",
        after: Place | None = None,
        kind: JobKind | None = None,
        model_id: str | None = None,
        tags: Collection[str] = (),
        made: Span = EVER,
    ) -> list[Job]:
        """Jobs, the newest first.

        Args:
            site_id: of this site alone.
            limit: how many at most.
            states: in one of these; none: in any.
            text: that the name or the id contains, whatever the case of its letters.
            after: only those that follow this place in the list.
            kind: of this kind alone.
            model_id: runs of this network alone.
            tags: that have all of these.
            made: when they were created.
        """
        newest = newest_first(select(JobRow).where(*made.holds(JobRow.created_at)), JobRow, limit, after)
        if site_id is not None:
            newest = newest.where(JobRow.site_id == site_id)
        if kind is not None:
            newest = newest.where(JobRow.kind == kind.value)
        if model_id is not None:
            newest = newest.where(JobRow.model_id == model_id)
        if states:
            newest = newest.where(JobRow.state.in_([state.value for state in states]))
        if text:
            newest = newest.where(
                or_(JobRow.name.icontains(text, autoescape=True), JobRow.id.contains(text, autoescape=True))
            )
        for tag in tags:
            newest = newest.where(JobRow.id.in_(select(JobTagRow.job_id).where(JobTagRow.tag == tag)))
        with self._database.reading() as session:
            return job_records(session, session.scalars(newest).all())

    def change(self, job_id: str, *, name: str | None = None, tags: Collection[str] | None = None) -> Job:
        """Call a job something, and mark it with tags in place of those that it has; None leaves them.

        Raises:
            NotFound: there is no such job.
        """
        with self._database.writing() as session:
            row = job_row(session, job_id, lock=True)
            if name is not None:
                row.name = records.plain_text(name)
            if tags is not None:
                session.execute(delete(JobTagRow).where(JobTagRow.job_id == job_id))
                add_tags(session, job_id, tags)
            session.flush()
            return job_record(session, row)

    def cancel(self, job_id: str) -> Job:
        """Ask a job to stop. A terminal job stays as it is.

        Raises:
            NotFound: there is no such job.
        """
        now = self._now()
        with self._database.writing() as session:
            row = job_row(session, job_id, lock=True)
            stages = stage_rows(session, job_id)
            apply(session, row, stages, cancel(JobState(row.state), nodes(stages)), now)
            session.flush()
            return job_record(session, row)

    def restart(
        self,
        job_id: str,
        options: Mapping[str, Any],
        plan: Sequence[PlannedStage],
        from_stage: str | None = None,
        files: Sequence[StoredFile] | None = None,
    ) -> tuple[Job, list[StageKey]]:
        """Let a job run again: the stages without outputs, those whose address changed, and, where ``from_stage`` is
        given, that stage and all that follow from it; of an earlier restart what was left of these, too. Where there
        are none, the job succeeds at once. With ``files``,
        it works on these from now on.

        Raises:
            NotFound: there is no such job.
            UnknownOption: there is no such stage.
            Conflict: it has not ended yet, or another job works with outputs that were to be made anew.
        """
        now = self._now()
        with self._database.writing(exclusive=True) as session:
            row = job_row(session, job_id, lock=True)
            if not JobState(row.state).is_terminal:
                raise Conflict(f"job {job_id} is {row.state}", hint="Cancel it first, or wait until it has ended.")
            stages = {stage.name: stage for stage in stage_rows(session, job_id)}
            anew = made_anew(plan, from_stage, {name: old.hash for name, old in stages.items() if old.forced})
            _check_not_in_use(session, job_id, [planned.hash for planned in plan if planned.name in anew])
            unsettled = _unsettled_hashes(session)
            fresh: list[StageRow] = []
            for position, planned in enumerate(plan):
                old = stages.pop(planned.name, None)
                again = planned.name in anew or planned.hash in unsettled
                if old is not None and _still_good(old, planned) and not again:
                    continue
                fence = 0
                if old is not None:
                    fence = old.fence + 1  # a worker that still holds it from before has lost it
                    session.delete(old)
                stage = _fresh_stage(job_id, position, planned)
                stage.forced, stage.fence = planned.name in anew, fence
                fresh.append(stage)
            for left_over in stages.values():
                session.delete(left_over)
            session.flush()
            session.add_all(fresh)
            if files is not None:
                _check_files_exist(session, files)
                session.execute(delete(JobFileRow).where(JobFileRow.job_id == job_id))
                session.add_all(JobFileRow(job_id=job_id, file_id=file.id) for file in files)
            check_job_move(JobState(row.state), JobState.QUEUED)
            row.state, row.options, row.error = JobState.QUEUED.value, dict(options), None
            row.started_at = row.finished_at = None
            row.restarts += 1
            add_event(session, row, EventKind.JOB, now, state=row.state, restarts=row.restarts)
            session.flush()
            ready = settle_job(session, row, now)
            session.flush()
            return job_record(session, row), ready

    def delete(self, job_id: str, remove_outputs: Callable[[str, str], None]) -> None:
        """Forget a job that has ended, and remove the stage outputs that no other job refers to.

        Args:
            job_id: which.
            remove_outputs: called with a stage's name and hash while no job can be created.

        Raises:
            NotFound: there is no such job.
            Conflict: it has not ended yet.
        """
        with self._database.writing(exclusive=True) as session:
            row = job_row(session, job_id, lock=True)
            if not JobState(row.state).is_terminal:
                raise Conflict(f"job {job_id} is {row.state}", hint="Cancel it first, or wait until it has ended.")
            addresses = [(stage.name, stage.hash) for stage in stage_rows(session, job_id)]
            session.delete(row)
            session.flush()
            for name, hash in addresses:
                if session.scalar(select(StageRow.name).where(StageRow.hash == hash).limit(1)) is None:
                    remove_outputs(name, hash)

    def frame_hashes_to_come(self) -> set[tuple[str, str]]:
        """Stages that have yet to run frame by frame, with their frame hashes: outputs with these save them work."""
        to_come = [state.value for state in StageState if not state.is_terminal]
        wanted = select(StageRow.name, StageRow.frame_hash).where(
            StageRow.frame_hash.is_not(None), StageRow.state.in_(to_come)
        )
        with self._database.reading() as session:
            return {(name, str(frame_hash)) for name, frame_hash in session.execute(wanted.distinct())}

    def drop_unnamed(self, addresses: Iterable[tuple[str, str]], remove_outputs: Callable[[str, str], None]) -> None:
        """Remove the outputs that no job refers to, left by a restart with other options or a death at a bad moment.

        Args:
            addresses: what there is: names of stages with (the first part of) their hashes, all of one length.
            remove_outputs: called with a stage's name and hash while no job can be created.
        """
        found = set(addresses)
        if not found:
            return
        with self._database.reading() as session:
            unnamed = _unnamed(session, found)
        if not unnamed:
            return
        with self._database.writing(exclusive=True) as session:
            for name, hash in sorted(_unnamed(session, unnamed)):
                remove_outputs(name, hash)

    def events(self, job_id: str, after: int = 0, limit: int = 500) -> tuple[list[Event], bool]:
        """Events with sequence numbers above ``after``, and whether no more will come (unless the job is restarted).

        Of the progress of a stage that has ended only the last report is kept.

        Raises:
            NotFound: there is no such job.
        """
        with self._database.reading() as session:
            row = job_row(session, job_id)
            rows = session.scalars(
                select(EventRow)
                .where(EventRow.job_id == job_id, EventRow.sequence > after)
                .order_by(EventRow.sequence)
                .limit(limit)
            ).all()
            last = rows[-1].sequence if rows else after
            return [records.event(event) for event in rows], row.state in _TERMINAL and last >= row.last_event


def _fresh_stage(job_id: str, position: int, planned: PlannedStage) -> StageRow:
    return StageRow(
        job_id=job_id,
        name=planned.name,
        position=position,
        hash=planned.hash,
        requires=list(planned.requires),
        frame_hash=planned.frame_hash,
        state=StageState.PENDING.value,
        forced=False,
        attempts=0,
        fence=0,
        fraction=0.0,
        message="",
    )


def _still_good(stage: StageRow, planned: PlannedStage) -> bool:
    return StageState(stage.state).has_outputs and stage.hash == planned.hash


def _unsettled_hashes(session: Session) -> set[str]:
    """The addresses that a job at work has yet to find or make outputs for: those that are there may still go."""
    at_work = select(JobRow.id).where(JobRow.state.not_in(_TERMINAL))
    without = [state.value for state in StageState if not state.has_outputs]
    return set(session.scalars(select(StageRow.hash).where(StageRow.job_id.in_(at_work), StageRow.state.in_(without))))


def _check_not_in_use(session: Session, job_id: str, hashes: Sequence[str]) -> None:
    user = session.scalar(
        select(JobRow.id)
        .join(StageRow, StageRow.job_id == JobRow.id)
        .where(StageRow.hash.in_(hashes), JobRow.id != job_id, JobRow.state.not_in(_TERMINAL))
        .limit(1)
    )
    if user is not None:
        raise Conflict(f"job {user} is working with the same stages", hint="Wait until it has ended.", job=user)


def _unnamed(session: Session, addresses: Collection[tuple[str, str]]) -> set[tuple[str, str]]:
    length = len(next(iter(addresses))[1])
    named = {hash[:length] for hash in session.scalars(select(StageRow.hash).distinct())}
    return {(name, hash) for name, hash in addresses if hash not in named}


def _check_files_exist(session: Session, files: Sequence[StoredFile]) -> None:
    ids = [file.id for file in files]
    there = set(session.scalars(select(FileRow.id).where(FileRow.id.in_(ids))))
    if len(there) < len(ids):
        raise Conflict("a recording was deleted while the job was being created", hint="Create the job again.")


def _job_of_key(session: Session, site_id: str, key: str, options: Mapping[str, Any]) -> Job | None:
    row = session.scalars(select(JobRow).where(JobRow.site_id == site_id, JobRow.idempotency_key == key)).one_or_none()
    if row is None:
        return None
    if row.options != dict(options):
        raise Conflict(
            f"this Idempotency-Key made job {row.id} with other options",
            hint="Use a new key for a new job.",
            job=row.id,
        )
    return job_record(session, row)
