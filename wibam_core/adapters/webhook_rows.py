"""What webhooks are told, written in the transaction in which it comes about: neither is there without the other."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import and_, or_, select
from sqlalchemy.orm import Session

from wibam_core.adapters import records
from wibam_core.adapters.models import DeliveryRow, JobRow, JobTagRow, WebhookRow
from wibam_core.jobs.states import JobState
from wibam_core.jobs.webhooks import EVENT_OF, DeliveryState, WebhookEvent


def announce(session: Session, job: JobRow, now: float) -> None:
    """Tell those who want to know that a job has come into its state."""
    event = EVENT_OF.get(JobState(job.state))
    if event is None:
        return
    nobody = and_(WebhookRow.site_id.is_(None), WebhookRow.job_id.is_(None))
    concerned = or_(WebhookRow.job_id == job.id, WebhookRow.site_id == job.site_id, nobody)
    wanting = [
        row for row in session.scalars(select(WebhookRow).where(WebhookRow.active, concerned)) if event in row.events
    ]
    if not wanting:
        return
    tags = session.scalars(select(JobTagRow.tag).where(JobTagRow.job_id == job.id).order_by(JobTagRow.tag)).all()
    told = {
        "job_id": job.id,
        "site_id": job.site_id,
        "name": job.name,
        "tags": list(tags),
        "kind": job.kind,
        "state": job.state,
        "restarts": job.restarts,
        "error": job.error if JobState(job.state) is JobState.FAILED else None,
    }
    for row in wanting:
        session.add(delivery_row(row.id, event, told, now))


def delivery_row(webhook_id: str, event: WebhookEvent, data: Mapping[str, Any], now: float) -> DeliveryRow:
    """A delivery that is due now."""
    body = {"type": event.value, "timestamp": datetime.fromtimestamp(now, UTC).isoformat(), "data": data}
    return DeliveryRow(
        id=records.new_id("msg"),
        webhook_id=webhook_id,
        event=event.value,
        body=json.dumps(records.plain_json(body), ensure_ascii=False),
        state=DeliveryState.PENDING.value,
        attempts=[],
        claims=0,
        next_at=now,
        created_at=now,
    )
