"""Webhooks: be told what becomes of jobs, instead of asking again and again."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from api.addresses import address
from api.bodies import BoundedJsonRoute
from api.paging import MadeDep, PageDep
from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.schemas import Id, JobName
from api.services import ServicesDep
from wibam_core.adapters.webhook_sending import check_url
from wibam_core.jobs.webhooks import USUAL_EVENTS, Delivery, DeliveryState, Webhook, WebhookEvent

router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"], responses=documented(401), route_class=BoundedJsonRoute)
Events = Annotated[list[WebhookEvent], Field(min_length=1, max_length=len(WebhookEvent))]


class WebhookIn(BaseModel):
    """Who is to be told of what."""

    model_config = ConfigDict(extra="forbid")

    url: str = Field(
        max_length=2000,
        description="gets a POST with JSON; must be public unless the operator allows its network",
        examples=["https://example.org/wibam"],
    )
    site_id: Id | None = Field(None, description="of the jobs of this site")
    job_id: Id | None = Field(None, description="of this job, which has not ended; both left out: of all jobs")
    events: Events = list(USUAL_EVENTS)
    name: JobName = ""


class WebhookChangeIn(BaseModel):
    """What of a webhook can be changed; what is left out stays."""

    model_config = ConfigDict(extra="forbid")

    name: JobName | None = None
    events: Events | None = None
    active: bool | None = Field(None, description="false: nothing is sent; what waits is kept")


class WebhookOut(BaseModel):
    """Who is told of what. Its secret is told once, when it is made."""

    id: str = Field(examples=["hook_3f0c9a1be2d44c70"])
    name: str
    url: str
    site_id: str | None
    job_id: str | None
    events: list[WebhookEvent]
    active: bool = Field(description="false, too, once the receiver has answered 410")
    created_at: datetime

    @classmethod
    def of(cls, webhook: Webhook) -> WebhookOut:
        return cls(**{**vars(webhook), "created_at": _time(webhook.created_at)})


class NewWebhookOut(WebhookOut):
    """A webhook that was just made."""

    secret: str = Field(description="of its signatures; it is told this once", examples=["whsec_..."])


class AttemptOut(BaseModel):
    """One try at sending."""

    at: datetime
    status: int | None = Field(description="of the receiver's answer; null: there was none")
    error: str
    seconds: float


class DeliveryOut(BaseModel):
    """Something that a webhook was, or is to be, told."""

    id: str = Field(description="the header `webhook-id`", examples=["msg_3f0c9a1be2d44c70"])
    event: WebhookEvent
    state: DeliveryState
    body: str = Field(description="JSON, as it is signed")
    attempts: list[AttemptOut] = Field(description="the oldest first")
    next_at: datetime | None = Field(description="when it is tried (again)")
    created_at: datetime

    @classmethod
    def of(cls, delivery: Delivery) -> DeliveryOut:
        return cls(
            id=delivery.id,
            event=delivery.event,
            state=delivery.state,
            body=delivery.body,
            attempts=[AttemptOut(**{**vars(one), "at": _time(one.at)}) for one in delivery.attempts],
            next_at=None if delivery.next_at is None else _time(delivery.next_at),
            created_at=_time(delivery.created_at),
        )


@router.post("", status_code=201, summary="Make a webhook", responses=documented(404, 409, 413, 422))
def create(body: WebhookIn, services: ServicesDep, request: Request, response: Response) -> NewWebhookOut:
    """What is sent is signed by the Standard Webhooks specification; `docs/service.md` shows how to check it."""
    url = check_url(body.url, services.settings.webhook_networks)
    made, secret = services.webhooks.create(url, body.events, site_id=body.site_id, job_id=body.job_id, name=body.name)
    response.headers["Location"] = address(request, f"/v1/webhooks/{made.id}")
    return NewWebhookOut(**WebhookOut.of(made).model_dump(), secret=secret)


@router.get("", summary="List webhooks", dependencies=[ONLY_KNOWN_PARAMETERS], responses=documented(422))
def list_webhooks(
    services: ServicesDep,
    page: PageDep,
    made: MadeDep,
    site: Annotated[str | None, Query(description="of this site alone")] = None,
    job: Annotated[str | None, Query(description="of this job alone")] = None,
) -> list[WebhookOut]:
    """The newest first."""
    found = services.webhooks.webhooks(page.one_more, site_id=site, job_id=job, made=made, after=page.place)
    return [WebhookOut.of(webhook) for webhook in page.cut(found, lambda webhook: (webhook.created_at, webhook.id))]


@router.get("/{webhook_id}", summary="Look at a webhook", responses=documented(404))
def get(webhook_id: str, services: ServicesDep) -> WebhookOut:
    return WebhookOut.of(services.webhooks.webhook(webhook_id))


@router.patch("/{webhook_id}", summary="Change a webhook", responses=documented(404, 422))
def change(webhook_id: str, body: WebhookChangeIn, services: ServicesDep) -> WebhookOut:
    changed = services.webhooks.change(webhook_id, name=body.name, events=body.events, active=body.active)
    return WebhookOut.of(changed)


@router.delete("/{webhook_id}", status_code=204, summary="Delete a webhook", responses=documented(404))
def delete(webhook_id: str, services: ServicesDep) -> None:
    """What it was not told yet is not sent any more."""
    services.webhooks.delete(webhook_id)


@router.post("/{webhook_id}/ping", status_code=202, summary="Try a webhook", responses=documented(404))
def ping(webhook_id: str, services: ServicesDep) -> DeliveryOut:
    """Sends it something at once; its deliveries tell what came of it."""
    return DeliveryOut.of(services.webhooks.ping(webhook_id))


@router.get(
    "/{webhook_id}/deliveries",
    summary="What a webhook was told",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(404, 422),
)
def deliveries(
    webhook_id: str,
    services: ServicesDep,
    page: PageDep,
    made: MadeDep,
    state: Annotated[list[DeliveryState] | None, Query(max_length=10, description="in any of these states")] = None,
) -> list[DeliveryOut]:
    """The newest first, kept for 30 days, with every attempt."""
    found = services.webhooks.deliveries(webhook_id, page.one_more, states=state or (), made=made, after=page.place)
    return [DeliveryOut.of(delivery) for delivery in page.cut(found, lambda one: (one.created_at, one.id))]


@router.post(
    "/{webhook_id}/deliveries/{delivery_id}/send",
    status_code=202,
    summary="Send something to a webhook again",
    responses=documented(404),
)
def send_again(webhook_id: str, delivery_id: str, services: ServicesDep) -> DeliveryOut:
    """Now, and if that fails as often as a new one. It keeps its id."""
    return DeliveryOut.of(services.webhooks.send_again(webhook_id, delivery_id))


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
