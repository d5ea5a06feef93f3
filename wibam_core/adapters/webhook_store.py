"""Webhooks and what was sent to them, in the database."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from wibam_core.adapters import records
from wibam_core.adapters.database import Database
from wibam_core.adapters.job_rows import job_row
from wibam_core.adapters.models import DeliveryRow, JobRow, SiteRow, WebhookRow
from wibam_core.adapters.paging import EVER, Place, Span, newest_first
from wibam_core.adapters.webhook_rows import delivery_row
from wibam_core.errors import Conflict, InputError, NotFound
from wibam_core.jobs.states import JobState
from wibam_core.jobs.webhooks import (
    Attempt,
    Delivery,
    DeliveryState,
    Webhook,
    WebhookEvent,
    after_attempt,
    new_secret,
)

_MOST_WEBHOOKS = 1000
_KEPT_S = 30 * 24 * 3600.0
_GONE = 410


@dataclass(frozen=True)
class Due:
    """A delivery that was taken to be sent now; ``claim`` tells who may say what became of it."""

    delivery: Delivery
    url: str
    secret: str
    claim: int


class WebhookStore:
    """Who is told, and what they were told.

    Args:
        database: migrated.
        now: Unix seconds.
    """

    def __init__(self, database: Database, now: Callable[[], float] = time.time) -> None:
        self._database = database
        self._now = now

    def create(
        self,
        url: str,
        events: Collection[WebhookEvent],
        *,
        site_id: str | None = None,
        job_id: str | None = None,
        name: str = "",
    ) -> tuple[Webhook, str]:
        """A new webhook, and the secret of its signatures.

        Raises:
            NotFound: there is no such site or job.
            Conflict: the job has ended already, or there are very many webhooks.
            InputError: a site and a job are named.
        """
        if site_id is not None and job_id is not None:
            raise InputError("a webhook is of a site or of a job", hint="Leave one out, or both for all jobs.")
        secret = new_secret()
        with self._database.writing(exclusive=True) as session:
            if site_id is not None and session.get(SiteRow, site_id) is None:
                raise NotFound(f"there is no site {site_id}", hint="List the sites to see their ids.")
            if job_id is not None and JobState((job := job_row(session, job_id)).state).is_terminal:
                raise Conflict(
                    f"job {job_id} is {job.state} already", hint="Ask for its site's jobs, or before it has ended."
                )
            if len(session.scalars(select(WebhookRow.id).limit(_MOST_WEBHOOKS)).all()) == _MOST_WEBHOOKS:
                raise Conflict(f"there are {_MOST_WEBHOOKS} webhooks", hint="Delete those that nobody needs.")
            row = WebhookRow(
                id=records.new_id("hook"),
                name=records.plain_text(name),
                url=url,
                site_id=site_id,
                job_id=job_id,
                events=[event.value for event in WebhookEvent if event in set(events)],
                secret=secret,
                active=True,
                created_at=self._now(),
            )
            session.add(row)
            session.flush()
            return _webhook(row), secret

    def webhooks(
        self,
        limit: int | None = None,
        *,
        site_id: str | None = None,
        job_id: str | None = None,
        made: Span = EVER,
        after: Place | None = None,
    ) -> list[Webhook]:
        """Webhooks, the newest first; those of one site or job alone where it is named."""
        wanted = select(WebhookRow).where(*made.holds(WebhookRow.created_at))
        if site_id is not None:
            wanted = wanted.where(WebhookRow.site_id == site_id)
        if job_id is not None:
            wanted = wanted.where(WebhookRow.job_id == job_id)
        with self._database.reading() as session:
            return [_webhook(row) for row in session.scalars(newest_first(wanted, WebhookRow, limit, after))]

    def webhook(self, webhook_id: str) -> Webhook:
        """Raises:
        NotFound: there is no such webhook.
        """
        with self._database.reading() as session:
            return _webhook(_row(session, webhook_id))

    def change(
        self,
        webhook_id: str,
        *,
        name: str | None = None,
        events: Collection[WebhookEvent] | None = None,
        active: bool | None = None,
    ) -> Webhook:
        """What is None stays. Of one that is no longer active, what waits is not sent before it is again.

        Raises:
            NotFound: there is no such webhook.
        """
        with self._database.writing() as session:
            row = _row(session, webhook_id)
            row.name = row.name if name is None else records.plain_text(name)
            row.events = row.events if events is None else [event.value for event in WebhookEvent if event in events]
            row.active = row.active if active is None else active
            session.flush()
            return _webhook(row)

    def delete(self, webhook_id: str) -> None:
        """Forget a webhook and what it was told; nothing is sent to it any more.

        Raises:
            NotFound: there is no such webhook.
        """
        with self._database.writing() as session:
            session.delete(_row(session, webhook_id))

    def ping(self, webhook_id: str) -> Delivery:
        """Send something to a webhook, whatever it wants to know. Raises as `webhook` does."""
        with self._database.writing() as session:
            hook = _row(session, webhook_id)
            row = delivery_row(hook.id, WebhookEvent.PING, {"webhook_id": hook.id}, self._now())
            session.add(row)
            session.flush()
            return _delivery(row)

    def deliveries(
        self,
        webhook_id: str,
        limit: int | None = None,
        *,
        states: Collection[DeliveryState] = (),
        made: Span = EVER,
        after: Place | None = None,
    ) -> list[Delivery]:
        """What a webhook was told, the newest first; kept for 30 days. Raises as `webhook` does."""
        wanted = select(DeliveryRow).where(DeliveryRow.webhook_id == webhook_id, *made.holds(DeliveryRow.created_at))
        if states:
            wanted = wanted.where(DeliveryRow.state.in_([state.value for state in states]))
        with self._database.reading() as session:
            _row(session, webhook_id)
            return [_delivery(row) for row in session.scalars(newest_first(wanted, DeliveryRow, limit, after))]

    def send_again(self, webhook_id: str, delivery_id: str) -> Delivery:
        """Let a delivery be tried now, and as often as a new one.

        Raises:
            NotFound: there is no such delivery.
        """
        with self._database.writing() as session:
            row = session.get(DeliveryRow, delivery_id)
            if row is None or row.webhook_id != webhook_id:
                raise NotFound(f"webhook {webhook_id} has no delivery {delivery_id}", hint="List its deliveries.")
            row.state, row.attempts, row.next_at = DeliveryState.PENDING.value, [], self._now()
            row.claims += 1  # whoever is sending it now has lost it
            session.flush()
            return _delivery(row)

    def take(self, most: int, lease_s: float, most_each: int | None = None, busy: Collection[str] = ()) -> list[Due]:
        """Take deliveries that are due, the longest waiting first, for so long as a lease: if nothing is said of one by
        then, as where its sender died, it is due again.

        Args:
            most: so many at most.
            lease_s: how long they are taken for.
            most_each: so many at most of one webhook, however many of it wait.
            busy: ids of webhooks of which none is taken.
        """
        now = self._now()
        due = (
            select(DeliveryRow.id)
            .join(WebhookRow, WebhookRow.id == DeliveryRow.webhook_id)
            .where(DeliveryRow.state == DeliveryState.PENDING.value, DeliveryRow.next_at <= now, WebhookRow.active)
            .where(DeliveryRow.webhook_id.not_in(busy))
        )
        with self._database.reading() as session:
            if session.execute(due.limit(1)).first() is None:
                return []  # mostly; no lock is taken for it
        place = func.row_number().over(
            partition_by=DeliveryRow.webhook_id, order_by=(DeliveryRow.next_at, DeliveryRow.id)
        )
        ranked = due.add_columns(place.label("place")).subquery()
        taken = (
            select(DeliveryRow, WebhookRow)
            .join(WebhookRow, WebhookRow.id == DeliveryRow.webhook_id)
            .join(ranked, ranked.c.id == DeliveryRow.id)
            .where(ranked.c.place <= (most if most_each is None else most_each))
            .order_by(DeliveryRow.next_at)
            .limit(most)
        )
        found = []
        with self._database.writing(exclusive=True) as session:
            for row, hook in session.execute(taken):
                row.claims += 1
                row.next_at = now + lease_s
                found.append(Due(_delivery(row), hook.url, hook.secret, row.claims))
        return found

    def note(self, due: Due, attempt: Attempt) -> None:
        """Say what became of a delivery that was taken; nothing where it was taken by another meanwhile.

        A receiver that is gone for good (410) is told nothing any more.
        """
        with self._database.writing(exclusive=True) as session:
            row = session.get(DeliveryRow, due.delivery.id)
            if row is None or row.claims != due.claim:
                return
            attempts = [*due.delivery.attempts, attempt]
            state, row.next_at = after_attempt(attempts, self._now())
            row.state, row.attempts = state.value, [asdict(one) for one in attempts]
            if attempt.status == _GONE:
                row.state, row.next_at = DeliveryState.FAILED.value, None
                _row(session, row.webhook_id).active = False

    def tidy(self) -> None:
        """Drop old deliveries, and webhooks of jobs and sites that are gone and wait for nothing."""
        now = self._now()
        waiting = select(DeliveryRow.webhook_id).where(DeliveryRow.state == DeliveryState.PENDING.value)
        jobs, sites = select(JobRow.id), select(SiteRow.id)
        orphans = (WebhookRow.job_id.not_in(jobs)) | (WebhookRow.site_id.not_in(sites))
        with self._database.writing() as session:
            session.execute(delete(DeliveryRow).where(DeliveryRow.created_at < now - _KEPT_S))
            session.execute(delete(WebhookRow).where(orphans, WebhookRow.id.not_in(waiting)))


def _row(session: Session, webhook_id: str) -> WebhookRow:
    row = session.get(WebhookRow, webhook_id)
    if row is None:
        raise NotFound(f"there is no webhook {webhook_id}", hint="List the webhooks to see their ids.")
    return row


def _webhook(row: WebhookRow) -> Webhook:
    events: Sequence[WebhookEvent] = [WebhookEvent(event) for event in row.events]
    return Webhook(row.id, row.name, row.url, row.site_id, row.job_id, tuple(events), row.active, row.created_at)


def _delivery(row: DeliveryRow) -> Delivery:
    return Delivery(
        id=row.id,
        webhook_id=row.webhook_id,
        event=WebhookEvent(row.event),
        body=row.body,
        state=DeliveryState(row.state),
        attempts=tuple(Attempt(**attempt) for attempt in row.attempts),
        next_at=row.next_at,
        created_at=row.created_at,
    )
