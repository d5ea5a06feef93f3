"""Changes of a job and its stages inside one transaction. Whoever changes a job holds its row from beginning to end."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from sqlalchemy import Row, delete, func, select
from sqlalchemy.orm import Session

from wibam_core.adapters import records
from wibam_core.adapters.models import EventRow, FileRow, JobFileRow, JobRow, JobTagRow, StageRow
from wibam_core.adapters.webhook_rows import announce
from wibam_core.errors import NotFound
from wibam_core.jobs.machine import Settlement, StageNode, check_job_move, check_stage_move, settle
from wibam_core.jobs.records import EventKind, Job, StoredFile
from wibam_core.jobs.states import JobState, StageState


class StageKey(NamedTuple):
    """A stage of a job, as messages name it."""

    job_id: str
    stage: str


def job_row(session: Session, job_id: str, *, lock: bool = False) -> JobRow:
    """Args:
        session: a transaction; a writing one to ``lock`` the row against concurrent changes.
        job_id: which.
        lock: hold the row until the transaction ends.

    Raises:
        NotFound: there is no such job.
    """
    row = session.get(JobRow, job_id, with_for_update=lock or None)
    if row is None:
        raise NotFound(f"there is no job {job_id}", hint="List the jobs to see their ids.")
    return row


def stage_rows(session: Session, job_id: str) -> list[StageRow]:
    """The stages of a job, in the order of the pipeline."""
    return list(session.scalars(select(StageRow).where(StageRow.job_id == job_id).order_by(StageRow.position)))


def job_record(session: Session, row: JobRow) -> Job:
    """The whole job."""
    return job_records(session, [row])[0]


def job_records(session: Session, rows: Sequence[JobRow]) -> list[Job]:
    """Whole jobs, in as many queries as one takes."""
    ids = [row.id for row in rows]
    stages: dict[str, list[Row[Any]]] = {job_id: [] for job_id in ids}
    # plain rows: they are read once, and a list of jobs has thousands
    columns = select(*StageRow.__table__.columns)
    for stage in session.execute(columns.where(StageRow.job_id.in_(ids)).order_by(StageRow.position)):
        stages[stage.job_id].append(stage)
    files = _files_of(session, ids)
    tags: dict[str, list[str]] = {job_id: [] for job_id in ids}
    for tag in session.scalars(select(JobTagRow).where(JobTagRow.job_id.in_(ids)).order_by(JobTagRow.tag)):
        tags[tag.job_id].append(tag.tag)
    return [records.job(row, files[row.id], stages[row.id], tags[row.id]) for row in rows]


def add_tags(session: Session, job_id: str, tags: Collection[str]) -> None:
    """Mark a job that has no tags yet."""
    session.add_all(JobTagRow(job_id=job_id, tag=tag) for tag in sorted({records.plain_text(tag) for tag in tags}))


def job_files(session: Session, job_id: str) -> list[StoredFile]:
    """The files that a job works on."""
    return _files_of(session, [job_id])[job_id]


def _files_of(session: Session, job_ids: Sequence[str]) -> dict[str, list[StoredFile]]:
    rows = session.execute(
        select(JobFileRow.job_id, FileRow)
        .join(FileRow, JobFileRow.file_id == FileRow.id)
        .where(JobFileRow.job_id.in_(job_ids))
        .order_by(FileRow.purpose, FileRow.camera_id)
    )
    files: dict[str, list[StoredFile]] = {job_id: [] for job_id in job_ids}
    for job_id, row in rows:
        files[job_id].append(records.stored_file(row))
    return files


def nodes(stages: Sequence[StageRow]) -> list[StageNode]:
    return [StageNode(stage.name, StageState(stage.state), tuple(stage.requires)) for stage in stages]


def add_event(session: Session, job: JobRow, kind: EventKind, now: float, **data: Any) -> None:
    """Append an event; the job's row must be locked, so that no two have one sequence number."""
    job.last_event += 1
    session.add(
        EventRow(job_id=job.id, sequence=job.last_event, kind=kind.value, at=now, data=records.plain_json(data))
    )


def thin_progress(session: Session, job: JobRow, stage: str) -> None:
    """Forget how far a stage of a job was, but for the last report. Sequence numbers are not given again."""
    reports = (
        EventRow.job_id == job.id,
        EventRow.kind == EventKind.PROGRESS.value,
        EventRow.data["stage"].as_string() == stage,
    )
    last = select(func.max(EventRow.sequence)).where(*reports).scalar_subquery()
    session.execute(delete(EventRow).where(*reports, EventRow.sequence < last))


def move_job(
    session: Session, job: JobRow, state: JobState, now: float, error: Mapping[str, Any] | None = None
) -> None:
    """Change a job's state, and tell."""
    check_job_move(JobState(job.state), state)
    job.state = state.value
    if state is JobState.RUNNING or (state is JobState.SUCCEEDED and job.started_at is None):
        job.started_at = now  # the second: there was nothing to do
    if state.is_terminal:
        job.finished_at = now
    if error is not None:
        job.error = dict(error)
    add_event(session, job, EventKind.JOB, now, state=state.value, error=error)
    announce(session, job, now)


def move_stage(session: Session, job: JobRow, stage: StageRow, state: StageState, now: float, **news: Any) -> None:
    """Change a stage's state, give up its lease, and tell."""
    check_stage_move(StageState(stage.state), state)
    stage.state = state.value
    stage.lease_owner = stage.lease_expires_at = None
    stage.dispatched_at = now if state is StageState.QUEUED else None
    if state.is_terminal and stage.started_at is not None:
        stage.finished_at = now
    add_event(session, job, EventKind.STAGE, now, stage=stage.name, state=state.value, **news)


def settle_job(session: Session, job: JobRow, now: float) -> list[StageKey]:
    """Let follow what follows (`machine.settle`); returns the stages to dispatch once the transaction is committed."""
    stages = stage_rows(session, job.id)
    return apply(session, job, stages, settle(JobState(job.state), nodes(stages)), now)


def apply(
    session: Session, job: JobRow, stages: Sequence[StageRow], settlement: Settlement, now: float
) -> list[StageKey]:
    """Write what `machine.settle` or `machine.cancel` decided."""
    by_name = {stage.name: stage for stage in stages}
    for name, state in settlement.moves.items():
        move_stage(session, job, by_name[name], state, now)
    if settlement.job is not JobState(job.state):
        move_job(session, job, settlement.job, now, _first_error(stages, settlement.job))
    return [StageKey(job.id, name) for name in settlement.queued]


def _first_error(stages: Sequence[StageRow], state: JobState) -> Mapping[str, Any] | None:
    if state is not JobState.FAILED:
        return None
    failed = next(stage for stage in stages if stage.state == StageState.FAILED.value)
    assert failed.error is not None
    return {**failed.error, "details": {**failed.error["details"], "stage": failed.name}}
