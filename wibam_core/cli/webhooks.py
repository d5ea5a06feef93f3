"""`wibam webhooks`: who is told what becomes of jobs."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console

from wibam_core.cli.display import print_rows, to_minute
from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect
from wibam_core.jobs.webhooks import USUAL_EVENTS, WebhookEvent

app = typer.Typer(help="Let a program of yours be told what becomes of jobs.", no_args_is_help=True)
WebhookId = Annotated[str, typer.Argument(help="The id of a webhook.")]


@app.command("list")
def list_webhooks(url: Url = DEFAULT_URL, token: Token = "") -> None:
    """List webhooks, the newest first."""
    with connect(url, token) as client:
        webhooks = client.webhooks()
    rows = (
        (hook.id, hook.job_id or hook.site_id or "all jobs", "yes" if hook.active else "no", hook.url, hook.name)
        for hook in webhooks
    )
    print_rows(("webhook", "of"), ("active", "address", "name"), rows)


@app.command()
def create(
    address: Annotated[str, typer.Argument(help="Gets a POST, e.g. https://example.org/wibam.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
    site: Annotated[str | None, typer.Option(help="Of the jobs of this site.")] = None,
    job: Annotated[str | None, typer.Option(help="Of this job. Without either: of all jobs.")] = None,
    event: Annotated[list[WebhookEvent] | None, typer.Option(help="What it is told; left out: that jobs end.")] = None,
    name: Annotated[str, typer.Option(help="What you call it.")] = "",
) -> None:
    """Make a webhook. The secret of its signatures is printed once."""
    console = Console()
    with connect(url, token) as client:
        made = client.create_webhook(address, site_id=site, job_id=job, events=event or USUAL_EVENTS, name=name)
    console.print(made.id, highlight=False)
    console.print(f"[bold]{made.secret}[/]", highlight=False, soft_wrap=True)


@app.command()
def log(
    webhook_id: WebhookId,
    url: Url = DEFAULT_URL,
    token: Token = "",
    most: Annotated[int, typer.Option(help="How many at most.", min=1)] = 50,
) -> None:
    """Print what a webhook was told, the newest first, and what came of it."""
    with connect(url, token) as client:
        deliveries = client.deliveries(webhook_id, most)
    rows = (
        (
            one.id,
            one.event.value,
            one.state.value,
            str(len(one.attempts)),
            to_minute(one.created_at),
            to_minute(one.next_at),
            one.attempts[-1].error if one.attempts else "",
        )
        for one in deliveries
    )
    print_rows(("delivery", "event"), ("state", "tries", "from (UTC)", "next (UTC)", "what went wrong last"), rows)


@app.command()
def ping(webhook_id: WebhookId, url: Url = DEFAULT_URL, token: Token = "") -> None:
    """Send something to a webhook; `wibam webhooks log` tells what came of it."""
    with connect(url, token) as client:
        Console().print(client.ping_webhook(webhook_id).id, highlight=False)


@app.command()
def again(
    webhook_id: WebhookId,
    delivery_id: Annotated[str, typer.Argument(help="The id of a delivery.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
) -> None:
    """Send something to a webhook again, now."""
    with connect(url, token) as client:
        Console().print(client.send_again(webhook_id, delivery_id).id, highlight=False)


@app.command()
def delete(webhook_id: WebhookId, url: Url = DEFAULT_URL, token: Token = "") -> None:
    """Delete a webhook; nothing is sent to it any more."""
    with connect(url, token) as client:
        client.delete_webhook(webhook_id)
