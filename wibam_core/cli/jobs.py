"""`wibam jobs`: what a service works on."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from wibam_core.cli.display import print_rows, print_warning, time_left, to_minute
from wibam_core.cli.run import parse_options
from wibam_core.cli.service import DEFAULT_URL, JobDisplay, Token, Url, connect
from wibam_core.cli.service import watch as watch_job
from wibam_core.client import JobView
from wibam_core.job_kind import JobKind
from wibam_core.jobs.states import JobState

app = typer.Typer(help="Look at the jobs of a service, and steer them.", no_args_is_help=True)
JobId = Annotated[str, typer.Argument(help="The id of a job.")]


@app.command("list")
def list_jobs(
    url: Url = DEFAULT_URL,
    token: Token = "",
    site: Annotated[str | None, typer.Option(help="Of this site alone.")] = None,
    state: Annotated[list[JobState] | None, typer.Option(help="In any of these states.")] = None,
    tag: Annotated[list[str] | None, typer.Option(help="With all of these tags.")] = None,
    text: Annotated[str, typer.Option(help="That the name or the id contains.")] = "",
    kind: Annotated[JobKind, typer.Option(help="Trainings, or runs of networks.")] = JobKind.TRAINING,
    start: Annotated[
        str | None, typer.Option("--from", help="Created then or later, like 2026-07-01T08:00:00+02:00.")
    ] = None,
    end: Annotated[str | None, typer.Option("--to", help="Created before.")] = None,
    most: Annotated[int, typer.Option(help="How many at most.", min=1)] = 100,
) -> None:
    """List jobs, the newest first."""
    with connect(url, token) as client:
        jobs = client.jobs(
            site, states=state or (), tags=tag or (), text=text, kind=kind, start=start, end=end, most=most
        )
    rows = (
        (
            job.id,
            job.site_id,
            job.state.value,
            f"{job.fraction:.0%}",
            to_minute(job.created_at),
            _current_stage(job),
            job.name,
            ", ".join(job.tags),
        )
        for job in jobs
    )
    print_rows(("job", "site"), ("state", "done", "created (UTC)", "stage", "name", "tags"), rows)


@app.command()
def mark(
    job_id: JobId,
    url: Url = DEFAULT_URL,
    token: Token = "",
    name: Annotated[str | None, typer.Option(help="What you call it.")] = None,
    tag: Annotated[list[str] | None, typer.Option(help="In place of the tags that it has.")] = None,
    no_tags: Annotated[bool, typer.Option("--no-tags", help="Take its tags away.")] = False,
) -> None:
    """Call a job something, and give it tags by which it is found again."""
    if tag and no_tags:
        raise typer.BadParameter("--tag and --no-tags say the opposite", param_hint="--no-tags")
    with connect(url, token) as client:
        job = client.change_job(job_id, name=name, tags=[] if no_tags else tag or None)
    Console().print(f"{job.id}: {escape(job.name or 'no name')}; {escape(', '.join(job.tags) or 'no tags')}")


@app.command()
def show(job_id: JobId, url: Url = DEFAULT_URL, token: Token = "") -> None:
    """Show a job and its stages as they are now."""
    console = Console()
    with connect(url, token) as client:
        job = client.job(job_id)
    table = Table("stage", "state", "done", "seconds", "says")
    for stage in job.stages:
        seconds = "" if stage.seconds is None else f"{stage.seconds:.1f}"
        says = stage.error.message if stage.error is not None else stage.message
        table.add_row(stage.title, stage.state.value, f"{stage.fraction:.0%}", seconds, escape(says))
    console.print(table)
    for stage in job.stages:
        for warning in stage.warnings:
            print_warning(console, warning)
    left = "" if job.remaining_s is None else f", about {time_left(job.remaining_s)} left"
    console.print(f"{job.id}: {job.state}, {job.fraction:.0%} done{left}", highlight=False)
    if job.error is not None:
        console.print(f"[red]{escape(job.error.message)}[/] [dim]({job.error.code})[/]", highlight=False)
        console.print(escape(job.error.hint), highlight=False)


@app.command()
def create(
    site_id: Annotated[str, typer.Argument(help="The id of a site.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
    option: Annotated[list[str] | None, typer.Option("--set", help="An option, e.g. finetune.steps=200.")] = None,
    name: Annotated[str, typer.Option(help="What you call it.")] = "",
    tag: Annotated[list[str] | None, typer.Option(help="By which you find it again; several may be given.")] = None,
    dry_run: Annotated[bool, typer.Option(help="Only say which stages would run.")] = False,
) -> None:
    """Start a job on a site whose recordings are there."""
    console = Console()
    options = parse_options(option or [])
    with connect(url, token) as client:
        if dry_run:
            for stage in client.plan(site_id, options):
                console.print(f"{stage.would:>6}  {stage.title}", highlight=False)
            return
        console.print(client.create_job(site_id, options, name=name, tags=tag or ()).id, highlight=False)


@app.command()
def watch(job_id: JobId, url: Url = DEFAULT_URL, token: Token = "") -> None:
    """Watch a job until it has ended. Ctrl-C stops the watching, not the job."""
    console = Console()
    with connect(url, token) as client:
        job = watch_job(client, job_id, console)
        console.print(f"{job.id}: {job.state}", highlight=False)


@app.command()
def cancel(job_id: JobId, url: Url = DEFAULT_URL, token: Token = "") -> None:
    """Stop a job. Finished stages are kept."""
    console = Console()
    with connect(url, token) as client, JobDisplay(console) as display:
        client.cancel(job_id)
        job = client.wait(job_id, display.update, timeout_s=60.0)
    console.print(f"{job.id}: {job.state}", highlight=False)


@app.command()
def restart(
    job_id: JobId,
    url: Url = DEFAULT_URL,
    token: Token = "",
    from_stage: Annotated[str | None, typer.Option(help="Make this stage and all after it anew.")] = None,
) -> None:
    """Run a job again from the first stage that has no outputs."""
    with connect(url, token) as client:
        job = client.restart(job_id, from_stage)
    Console().print(f"{job.id}: {job.state}", highlight=False)


@app.command()
def log(
    job_id: JobId,
    url: Url = DEFAULT_URL,
    token: Token = "",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Go on until the job has ended.")] = False,
) -> None:
    """Print a job's log."""
    offset, complete = 0, False
    with connect(url, token) as client:
        while True:
            text, offset, complete = client.log(job_id, offset)
            typer.echo(text, nl=False)
            if complete or not (follow or text):
                return
            if not text:
                time.sleep(0.5)


@app.command()
def download(
    job_id: JobId,
    url: Url = DEFAULT_URL,
    token: Token = "",
    out: Annotated[Path, typer.Option(help="A file, or a folder to put it into under its own name.")] = Path(),
    stage: Annotated[list[str] | None, typer.Option(help="What these stages wrote; left out, all.")] = None,
    artifact: Annotated[list[str] | None, typer.Option(help="What is a part of these, e.g. tracks.")] = None,
) -> None:
    """Download a job's files as one zip archive."""
    with connect(url, token) as client:
        written = client.download_archive(job_id, out, stages=stage or (), artifacts=artifact or ())
    Console().print(f"[bold]{escape(str(written))}[/]", highlight=False, soft_wrap=True)


def _current_stage(job: JobView) -> str:
    active = [s.title for s in job.stages if s.state.value in ("running", "failed")]
    return ", ".join(active)
