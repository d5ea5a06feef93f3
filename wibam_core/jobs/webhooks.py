"""Webhooks: who is told of what becomes of jobs, how that is signed, and how often it is tried.

Headers, signature and secret are those of the Standard Webhooks specification 1.0
(https://github.com/standard-webhooks/standard-webhooks), which libraries of many languages verify.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from wibam_core.jobs.states import JobState

#: Every secret begins so: a leaked one can be found in texts.
SECRET_PREFIX: Final = "whsec_"
#: How long after each attempt that failed the next one comes, in seconds; after the last of them it is given up.
BACKOFF_S: Final = (5.0, 30.0, 120.0, 600.0, 1800.0, 2 * 3600.0, 5 * 3600.0, 10 * 3600.0, 14 * 3600.0)


class WebhookEvent(StrEnum):
    """What a webhook can tell. ``PING`` is sent when somebody asks for it."""

    RUNNING = "job.running"
    SUCCEEDED = "job.succeeded"
    FAILED = "job.failed"
    CANCELLED = "job.cancelled"
    PING = "ping"


#: What is told of a job when it comes into a state; of the other states nothing is.
EVENT_OF: Final = {
    JobState.RUNNING: WebhookEvent.RUNNING,
    JobState.SUCCEEDED: WebhookEvent.SUCCEEDED,
    JobState.FAILED: WebhookEvent.FAILED,
    JobState.CANCELLED: WebhookEvent.CANCELLED,
}
#: What is told where nobody chose: that a job has ended, however it did.
USUAL_EVENTS: Final = (WebhookEvent.SUCCEEDED, WebhookEvent.FAILED, WebhookEvent.CANCELLED)


class DeliveryState(StrEnum):
    """``PENDING`` is tried again."""

    PENDING = "pending"
    DELIVERED = "delivered"
    FAILED = "failed"


@dataclass(frozen=True)
class Webhook:
    """Who is told.

    Attributes:
        site_id: of the jobs of this site alone. job_id: of this job alone. Both None: of all jobs.
        events: of these alone.
        active: otherwise nothing is sent.
    """

    id: str
    name: str
    url: str
    site_id: str | None
    job_id: str | None
    events: tuple[WebhookEvent, ...]
    active: bool
    created_at: float


@dataclass(frozen=True)
class Attempt:
    """One try at sending.

    Attributes:
        at: Unix seconds.
        status: of the answer; None: there was none.
        error: what went wrong; empty where nothing did.
        seconds: how long it took.
    """

    at: float
    status: int | None
    error: str
    seconds: float


@dataclass(frozen=True)
class Delivery:
    """Something that a webhook is told.

    Attributes:
        id: the header ``webhook-id``, the same at every attempt: by it receivers know what they have had already.
        body: JSON, signed as it is.
        next_at: when it is tried (again), Unix seconds; None: not any more.
    """

    id: str
    webhook_id: str
    event: WebhookEvent
    body: str
    state: DeliveryState
    attempts: tuple[Attempt, ...]
    next_at: float | None
    created_at: float


def new_secret() -> str:
    """A fresh secret for signatures: 32 random bytes."""
    return SECRET_PREFIX + base64.b64encode(secrets.token_bytes(32)).decode()


def signed_headers(secret: str, delivery_id: str, timestamp_s: int, body: bytes) -> dict[str, str]:
    """The headers of a delivery.

    Args:
        secret: of the webhook, as `new_secret` makes it.
        delivery_id: which delivery it is.
        timestamp_s: when it is sent, Unix seconds: receivers refuse what is old.
        body: what is sent.
    """
    key = base64.b64decode(secret.removeprefix(SECRET_PREFIX))
    signed = b".".join((delivery_id.encode(), str(timestamp_s).encode(), body))
    signature = base64.b64encode(hmac.digest(key, signed, hashlib.sha256)).decode()
    return {
        "webhook-id": delivery_id,
        "webhook-timestamp": str(timestamp_s),
        "webhook-signature": f"v1,{signature}",
    }


def after_attempt(attempts: Sequence[Attempt], now: float) -> tuple[DeliveryState, float | None]:
    """What becomes of a delivery by its attempts so far, of which there is at least one, and when it is tried again."""
    last = attempts[-1]
    if last.status is not None and 200 <= last.status < 300:
        return DeliveryState.DELIVERED, None
    if len(attempts) > len(BACKOFF_S):
        return DeliveryState.FAILED, None
    return DeliveryState.PENDING, now + BACKOFF_S[len(attempts) - 1]
