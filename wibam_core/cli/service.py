"""What commands that talk to a service share: where it is, and how a job is shown."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer
from rich.console import Console

from wibam_core.cli.display import StageDisplay
from wibam_core.client import JobView, WibamClient
from wibam_core.errors import Unauthorised
from wibam_core.jobs.states import JobState, StageState
from wibam_core.stages.graph import STAGES

Url = Annotated[str, typer.Option(envvar="WIBAM_URL", help="Where the service is.")]
Token = Annotated[str, typer.Option(envvar="WIBAM_TOKEN", help="The API token; `wibam serve` prints it.")]
DEFAULT_URL = "http://127.0.0.1:8000"


def connect(url: str, token: str) -> WibamClient:
    """Raises:
    Unauthorised: no token was given.
    """
    if not token:
        raise Unauthorised("no API token was given", hint="Set WIBAM_TOKEN or use --token; `wibam serve` prints it.")
    return WibamClient(url, token)


class JobDisplay:
    """Shows a job's stages live. A context manager; give it every `JobView` you get."""

    def __init__(self, console: Console) -> None:
        self._display = StageDisplay(console)

    def __enter__(self) -> JobDisplay:
        self._display.__enter__()
        return self

    def __exit__(self, *details: object) -> None:
        self._display.__exit__(None, None, None)

    def update(self, job: JobView) -> None:
        """Bring the lines up to date."""
        for stage in job.stages:
            if stage.name not in STAGES:
                continue  # of a newer service
            state = "pending" if stage.state is StageState.QUEUED else stage.state.value
            figures = {name: value for name, value in stage.figures.items() if value is not None}
            running = stage.state is StageState.RUNNING
            self._display.update(
                stage.name, state, stage.fraction, stage.message if running else "", figures if running else None,
                stage.seconds, stage.warnings, stage.remaining_s if running else None,
                job.remaining_s if running else None,
            )  # fmt: skip


def watch(client: WibamClient, job_id: str, console: Console, check: Callable[[], None] = lambda: None) -> JobView:
    """Show a job until it has ended; ``check`` is called before every look, and what it raises ends the watching.

    Raises:
        WibamError: of the kind that made it fail.
    """
    with JobDisplay(console) as display:
        job = client.wait(job_id, display.update, check=check)
    if job.state is JobState.CANCELLED:
        console.print(f"job {job.id} was cancelled", highlight=False)
    job.raise_for_failure()
    return job
