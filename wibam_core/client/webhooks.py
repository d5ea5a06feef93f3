"""Webhooks of a service."""

from __future__ import annotations

from collections.abc import Iterable

from wibam_core.client.requests import Requests
from wibam_core.client.views import DeliveryView, NewWebhookView, WebhookView
from wibam_core.jobs.webhooks import USUAL_EVENTS, WebhookEvent


class WebhookRequests(Requests):
    """Be told what becomes of jobs."""

    def create_webhook(
        self,
        url: str,
        *,
        site_id: str | None = None,
        job_id: str | None = None,
        events: Iterable[WebhookEvent] = USUAL_EVENTS,
        name: str = "",
    ) -> NewWebhookView:
        """A webhook of a site's jobs, of one job, or of all jobs, with its secret, which is told this once."""
        body = {"url": url, "site_id": site_id, "job_id": job_id, "events": [*events], "name": name}
        return NewWebhookView.model_validate(self._connection.json("POST", "/v1/webhooks", json=body))

    def webhooks(self) -> list[WebhookView]:
        """The newest first."""
        return [WebhookView.model_validate(item) for item in self._connection.items("/v1/webhooks")]

    def change_webhook(self, webhook_id: str, *, active: bool) -> WebhookView:
        """Let a webhook rest, or send to it again."""
        path = f"/v1/webhooks/{webhook_id}"
        return WebhookView.model_validate(self._connection.json("PATCH", path, json={"active": active}))

    def delete_webhook(self, webhook_id: str) -> None:
        self._connection.request("DELETE", f"/v1/webhooks/{webhook_id}")

    def ping_webhook(self, webhook_id: str) -> DeliveryView:
        """Send something to a webhook at once."""
        return DeliveryView.model_validate(self._connection.json("POST", f"/v1/webhooks/{webhook_id}/ping"))

    def deliveries(self, webhook_id: str, most: int | None = None) -> list[DeliveryView]:
        """What a webhook was told, the newest first."""
        found = self._connection.items(f"/v1/webhooks/{webhook_id}/deliveries", most=most)
        return [DeliveryView.model_validate(item) for item in found]

    def send_again(self, webhook_id: str, delivery_id: str) -> DeliveryView:
        """Let a delivery be tried anew, now."""
        path = f"/v1/webhooks/{webhook_id}/deliveries/{delivery_id}/send"
        return DeliveryView.model_validate(self._connection.json("POST", path))
