"""What is counted in the database, by whatever process, and how the queue stands: for whoever watches the service."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from sqlalchemy import and_, func, select
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from wibam_core.adapters.database import Database
from wibam_core.adapters.models import CounterRow, EventRow, JobRow, StageRow
from wibam_core.jobs.records import EventKind
from wibam_core.jobs.states import StageState


class Counted(StrEnum):
    """What is counted. Attempts and seconds are of stages that ran, by how they ended."""

    ATTEMPTS = "attempts"
    SECONDS = "seconds"
    LEASE_LOSSES = "lease_losses"
    UPLOADED_BYTES = "uploaded_bytes"


def count(session: Session, what: Counted, by: float = 1.0, *, stage: str = "", outcome: str = "") -> None:
    """Count within a writing transaction: it counts if, and only if, the transaction is committed.

    Others who count the same wait until then.
    """
    values = {"name": what.value, "stage": stage, "outcome": outcome, "value": by}
    keys = [CounterRow.name, CounterRow.stage, CounterRow.outcome]
    more = {"value": CounterRow.value + by}
    if session.get_bind().dialect.name == "postgresql":
        session.execute(
            postgresql.insert(CounterRow).values(values).on_conflict_do_update(index_elements=keys, set_=more)
        )
    else:
        session.execute(sqlite.insert(CounterRow).values(values).on_conflict_do_update(index_elements=keys, set_=more))


@dataclass(frozen=True)
class Sight:
    """How a service stands at one moment.

    Attributes:
        waiting: stages that wait for a worker, by stage.
        running: stages that a worker has, by stage.
        oldest_waiting_s: how long the stage that has waited longest does; 0 where none waits.
        jobs: by state.
        counted: by what, stage and outcome, since the service was set up.
    """

    waiting: Mapping[str, int]
    running: Mapping[str, int]
    oldest_waiting_s: float
    jobs: Mapping[str, int]
    counted: Mapping[tuple[Counted, str, str], float]


class Watch:
    """Looks at the database.

    Args:
        database: migrated.
        now: Unix seconds.
    """

    def __init__(self, database: Database, now: Callable[[], float] = time.time) -> None:
        self._database = database
        self._now = now

    def look(self) -> Sight:
        """All of it as of one moment."""
        with self._database.reading() as session:
            by_stage = select(StageRow.name, func.count()).group_by(StageRow.name)
            waiting = session.execute(by_stage.where(StageRow.state == StageState.QUEUED.value)).all()
            running = session.execute(by_stage.where(StageRow.state == StageState.RUNNING.value)).all()
            since = _oldest_waits_since(session)
            jobs = session.execute(select(JobRow.state, func.count()).group_by(JobRow.state)).all()
            known = {what.value for what in Counted}
            rows = [row for row in session.scalars(select(CounterRow)) if row.name in known]
        return Sight(
            waiting={row[0]: row[1] for row in waiting},
            running={row[0]: row[1] for row in running},
            oldest_waiting_s=0.0 if since is None else max(self._now() - since, 0.0),
            jobs={row[0]: row[1] for row in jobs},
            counted={(Counted(row.name), row.stage, row.outcome): row.value for row in rows},
        )


def _oldest_waits_since(session: Session) -> float | None:
    """When the stage that has waited longest was queued (Unix seconds): for the last time, as its events tell."""
    queued = (
        select(func.max(EventRow.at).label("at"))
        .select_from(StageRow)
        .join(
            EventRow,
            and_(
                EventRow.job_id == StageRow.job_id,
                EventRow.kind == EventKind.STAGE.value,
                EventRow.data["stage"].as_string() == StageRow.name,
                EventRow.data["state"].as_string() == StageState.QUEUED.value,
            ),
        )
        .where(StageRow.state == StageState.QUEUED.value)
        .group_by(StageRow.job_id, StageRow.name)
        .subquery()
    )
    found: float | None = session.scalar(select(func.min(queued.c.at)))
    return found
