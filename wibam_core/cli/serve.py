"""`wibam serve`: the whole service, from one command."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
from rich.console import Console

from wibam_core.cli.embedded import EmbeddedService


def serve(
    data: Annotated[Path, typer.Option(help="Where everything is kept. Made if need be.")] = Path("wibam-data"),
    host: Annotated[str, typer.Option(help="Where to listen. Other machines can reach 0.0.0.0.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="0 picks a free one.", min=0, max=65535)] = 8000,
    workers: Annotated[int, typer.Option(help="How many stages may run at once.", min=1, max=64)] = 1,
    token: Annotated[
        str | None, typer.Option(envvar="WIBAM_TOKEN", help="The API token. Default: the one in the data folder.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Try what a hostile recording could do on this system, say so, and end.")
    ] = False,
) -> None:
    """Serve the HTTP API, with a worker and all that they need. Ctrl-C ends it; running stages go on next time."""
    if check:
        raise typer.Exit(subprocess.run([sys.executable, "-m", "worker.attacks"]).returncode)
    console = Console()
    signal.signal(signal.SIGTERM, _interrupt)
    with EmbeddedService(data, host=host, port=port, workers=workers, token=token) as service:
        console.print(f"WIBAM is at  [bold]{service.url}[/]   (API: {service.url}/docs)", highlight=False)
        console.print(f"token        [bold]{service.token}[/]", highlight=False, soft_wrap=True)
        console.print(f"signed in    {service.pages_url}", highlight=False, soft_wrap=True)
        console.print(f"data         {service.data_dir}", highlight=False, soft_wrap=True)
        console.print("\nFor the commands `wibam upload`, `jobs` and `tracks`:", highlight=False)
        console.print(f"  export WIBAM_URL={service.url} WIBAM_TOKEN={service.token}", highlight=False, soft_wrap=True)
        try:
            service.wait()
        except KeyboardInterrupt:
            console.print("stopping ...")


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
