"""Networks that the service keeps, in the database."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from sqlalchemy import delete, func, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from wibam_core.adapters import records
from wibam_core.adapters.database import Database
from wibam_core.adapters.models import JobRow, StageRow, TrainedModelRow
from wibam_core.adapters.paging import EVER, Place, Span, newest_first
from wibam_core.documents.trained_model import ModelDocument
from wibam_core.errors import Conflict, NotFound
from wibam_core.job_kind import JobKind
from wibam_core.jobs.records import ModelState, TrainedModel
from wibam_core.jobs.states import JobState, StageState

_TERMINAL = [state.value for state in JobState if state.is_terminal]
#: The row of a deleted network of a job stays, so that the job's is not kept again by itself.
_DELETED = "deleted"
_WITH_OUTPUTS = [state.value for state in StageState if state.has_outputs]


@dataclass(frozen=True)
class NewModel:
    """A network whose files are in place, to be kept; the fields are those of `TrainedModel`.

    ``stage_hash`` is the address of the outputs of fine-tuning that it was taken from.
    """

    id: str
    name: str
    site_id: str
    job_id: str | None
    stage_hash: str | None
    sha256: str
    size_bytes: int
    has_onnx: bool
    has_usual: bool
    document: ModelDocument


class ModelStore:
    """What is known of the networks.

    Args:
        database: migrated.
        now: Unix seconds.
    """

    def __init__(self, database: Database, now: Callable[[], float] = time.time) -> None:
        self._database = database
        self._now = now

    def add(self, model: NewModel) -> TrainedModel | None:
        """Keep a network as the next version of its site's; None where it is kept already: the same one of its job, or,
        of an upload, one of the site with the same file.
        """
        same = (TrainedModelRow.job_id == model.job_id) & (TrainedModelRow.stage_hash == model.stage_hash)
        try:
            with self._database.writing(exclusive=True) as session:
                latest = session.scalar(
                    select(func.max(TrainedModelRow.version)).where(TrainedModelRow.site_id == model.site_id)
                )
                session.execute(delete(TrainedModelRow).where(same, TrainedModelRow.state == _DELETED))
                if model.job_id is None and _same_file(session, model.site_id, model.sha256) is not None:
                    return None
                row = TrainedModelRow(
                    id=model.id,
                    name=records.plain_text(model.name)[:200],
                    site_id=model.site_id,
                    version=(latest or 0) + 1,
                    state=ModelState.CANDIDATE.value,
                    job_id=model.job_id,
                    stage_hash=model.stage_hash,
                    sha256=model.sha256,
                    size_bytes=model.size_bytes,
                    has_onnx=model.has_onnx,
                    has_usual=model.has_usual,
                    document=model.document.model_dump_json(by_alias=True),
                    created_at=self._now(),
                )
                session.add(row)
                session.flush()
                return records.trained_model(row)
        except IntegrityError:
            return None

    def models(
        self,
        site_id: str | None = None,
        limit: int = 100,
        *,
        job_id: str | None = None,
        states: Collection[ModelState] = (),
        text: str = "",
        made: Span = EVER,
        after: Place | None = None,
    ) -> list[TrainedModel]:
        """Networks, the newest first.

        Args:
            site_id: of this site alone.
            limit: how many at most.
            job_id: made by this job.
            states: in one of these; none: in any.
            text: that the name or the id contains, whatever the case of its letters.
            made: when they were kept.
            after: only those that follow this place in the list.
        """
        newest = select(TrainedModelRow).where(
            TrainedModelRow.state != _DELETED, *made.holds(TrainedModelRow.created_at)
        )
        newest = newest_first(newest, TrainedModelRow, limit, after)
        if site_id is not None:
            newest = newest.where(TrainedModelRow.site_id == site_id)
        if job_id is not None:
            newest = newest.where(TrainedModelRow.job_id == job_id)
        if states:
            newest = newest.where(TrainedModelRow.state.in_([state.value for state in states]))
        if text:
            named = TrainedModelRow.name.icontains(text, autoescape=True)
            newest = newest.where(named | TrainedModelRow.id.contains(text, autoescape=True))
        with self._database.reading() as session:
            return [records.trained_model(row) for row in session.scalars(newest)]

    def model(self, model_id: str) -> TrainedModel:
        """Raises:
        NotFound: there is no such network.
        """
        with self._database.reading() as session:
            return records.trained_model(model_row(session, model_id))

    def promoted(self, site_id: str) -> TrainedModel:
        """The network to use for a site.

        Raises:
            NotFound: none is promoted.
        """
        found = self.models(site_id, 1, states=[ModelState.PROMOTED])
        if not found:
            raise NotFound(f"no model of site {site_id} is promoted", hint="Name a model, or promote one.")
        return found[0]

    def of_site_and_file(self, site_id: str, sha256: str) -> TrainedModel | None:
        """The oldest network of a site with this file."""
        with self._database.reading() as session:
            row = _same_file(session, site_id, sha256)
            return None if row is None else records.trained_model(row)

    def of_file(self, sha256: str) -> TrainedModel | None:
        """A network with this file, the oldest."""
        kept = (TrainedModelRow.sha256 == sha256) & (TrainedModelRow.state != _DELETED)
        oldest = select(TrainedModelRow).where(kept).order_by(TrainedModelRow.created_at)
        with self._database.reading() as session:
            row = session.scalar(oldest.limit(1))
            return None if row is None else records.trained_model(row)

    def change(self, model_id: str, *, name: str | None = None, state: ModelState | None = None) -> TrainedModel:
        """Call a network something, promote it, retire it, or make it a candidate again.

        To promote one makes the one that was promoted a candidate.

        Raises:
            NotFound: there is no such network.
        """
        with self._database.writing(exclusive=True) as session:
            row = model_row(session, model_id)
            if name is not None:
                row.name = records.plain_text(name)
            if state is ModelState.PROMOTED:
                others = (TrainedModelRow.site_id == row.site_id) & (TrainedModelRow.state == state.value)
                session.execute(update(TrainedModelRow).where(others).values(state=ModelState.CANDIDATE.value))
            if state is not None:
                row.state = state.value
            session.flush()
            session.refresh(row)
            return records.trained_model(row)

    def delete(self, model_id: str) -> None:
        """Forget a network; its files may go then. That of a job comes back only where somebody asks for it.

        Raises:
            NotFound: there is no such network.
            Conflict: a run that has not ended works with it.
        """
        with self._database.writing(exclusive=True) as session:
            row = model_row(session, model_id)
            using = session.scalar(
                select(JobRow.id).where(JobRow.model_id == model_id, JobRow.state.not_in(_TERMINAL)).limit(1)
            )
            if using is not None:
                raise Conflict(f"run {using} works with model {model_id}", hint="Cancel it first, or wait.", run=using)
            if row.job_id is None:
                session.delete(row)
            else:
                row.state = _DELETED

    def ids(self) -> set[str]:
        """Of all networks."""
        with self._database.reading() as session:
            return set(session.scalars(select(TrainedModelRow.id).where(TrainedModelRow.state != _DELETED)))

    def jobs_to_keep(self, limit: int = 100) -> list[tuple[str, str]]:
        """Jobs that have trained, evaluated and used a network which is neither kept nor deleted, the newest first.

        Of each its id, and the address of what fine-tuning has made.
        """
        trained = select(StageRow.job_id, StageRow.hash).where(
            StageRow.name == "finetune", StageRow.state.in_(_WITH_OUTPUTS)
        )
        tracked = select(StageRow.job_id).where(StageRow.name == "track", StageRow.state.in_(_WITH_OUTPUTS))
        evaluated = select(StageRow.job_id).where(StageRow.name == "evaluate", StageRow.state.in_(_WITH_OUTPUTS))
        # conflicts say how tracks err; where they cannot be had, a job ends without
        judged = select(StageRow.job_id).where(StageRow.name == "safety", StageRow.state.in_(_WITH_OUTPUTS))
        found = trained.subquery()
        wanted = (
            select(JobRow.id, found.c.hash)
            .join(found, found.c.job_id == JobRow.id)
            .outerjoin(
                TrainedModelRow,
                (TrainedModelRow.job_id == JobRow.id) & (TrainedModelRow.stage_hash == found.c.hash),
            )
            .where(
                JobRow.kind == JobKind.TRAINING.value,
                JobRow.id.in_(tracked),
                JobRow.id.in_(evaluated),
                JobRow.id.in_(judged) | JobRow.state.in_(_TERMINAL),
                TrainedModelRow.id.is_(None),
            )
            .order_by(JobRow.created_at.desc())
            .limit(limit)
        )
        with self._database.reading() as session:
            return [(job_id, stage_hash) for job_id, stage_hash in session.execute(wanted)]


def _same_file(session: Session, site_id: str, sha256: str) -> TrainedModelRow | None:
    kept = (TrainedModelRow.site_id == site_id, TrainedModelRow.sha256 == sha256, TrainedModelRow.state != _DELETED)
    return session.scalar(select(TrainedModelRow).where(*kept).order_by(TrainedModelRow.created_at).limit(1))


def model_row(session: Session, model_id: str) -> TrainedModelRow:
    """Raises:
    NotFound: there is no such network.
    """
    row = session.get(TrainedModelRow, model_id)
    if row is None or row.state == _DELETED:
        raise NotFound(f"there is no model {model_id}", hint="List the models to see their ids.")
    return row
