"""`wibam keys`: who may use a service, and who changed what."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from wibam_core.cli.display import list_table, print_list
from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect
from wibam_core.jobs.access import Scope

app = typer.Typer(help="Give out API keys with scopes, take them back, see who changed what.", no_args_is_help=True)
_SCOPES = "; ".join(f"{scope}: {scope.meaning}" for scope in Scope)


@app.command("list")
def list_keys(url: Url = DEFAULT_URL, token: Token = "") -> None:
    """List keys, the newest first."""
    table = list_table("key", "name", others=("scopes", "works", "expires (UTC)", "last used (UTC)"))
    with connect(url, token) as client:
        for key in client.api_keys():
            works = "yes" if key.works else "no"
            table.add_row(
                key.id, escape(key.name), ", ".join(key.scopes), works, _day(key.expires_at), _day(key.last_used_at)
            )
    print_list(Console(), table)


@app.command()
def create(
    name: Annotated[str, typer.Argument(help="Whose key it is, or what for.")],
    scope: Annotated[list[Scope], typer.Option(help=f"May be given several times. {_SCOPES}.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
    days: Annotated[float | None, typer.Option(help="It works so long. Left out: until revoked.", min=0.001)] = None,
) -> None:
    """Make a key. Its secret is printed once and kept nowhere."""
    console = Console()
    with connect(url, token) as client:
        key = client.create_key(name, [one.value for one in scope], days)
    console.print(f"{key.id} for {escape(key.name)}: {', '.join(key.scopes)}", highlight=False)
    console.print(f"[bold]{key.secret}[/]", highlight=False, soft_wrap=True)
    console.print("Send it as the token (WIBAM_TOKEN). It is not shown again.", highlight=False)


@app.command()
def revoke(
    key_id: Annotated[str, typer.Argument(help="The id of a key.")], url: Url = DEFAULT_URL, token: Token = ""
) -> None:
    """Let a key open nothing from now on."""
    with connect(url, token) as client:
        key = client.revoke_key(key_id)
    Console().print(f"{key.id} ({escape(key.name)}) works no more", highlight=False)


@app.command()
def audit(
    url: Url = DEFAULT_URL,
    token: Token = "",
    limit: Annotated[int, typer.Option(help="So many lines.", min=1, max=1000)] = 50,
) -> None:
    """Print who changed what, the newest first."""
    table = list_table("at (UTC)", "who", others=("what", "status", "request"))
    with connect(url, token) as client:
        for line in client.audit(limit):
            table.add_row(
                line.at[:19].replace("T", " "), line.who, escape(line.what), str(line.status), line.request_id
            )
    print_list(Console(), table)


def _day(iso: str | None) -> str:
    return "" if iso is None else iso[:16].replace("T", " ")
