"""`wibam upload`: a site folder to a service."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from wibam_core.cli.run import parse_options
from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect, watch
from wibam_core.client import UploadProgress, WibamClient
from wibam_core.stages.runner import SiteFolder


def upload(
    site_dir: Annotated[Path, typer.Argument(help="A site folder: site.json and recordings/.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
    run: Annotated[bool, typer.Option("--run", help="Start a job, and watch it.")] = False,
    option: Annotated[list[str] | None, typer.Option("--set", help="With --run: e.g. finetune.steps=200.")] = None,
) -> None:
    """Send a site and its files to a service. A broken connection is taken up where it broke."""
    console = Console()
    options = parse_options(option or [])
    folder = SiteFolder.load(site_dir)
    with connect(url, token) as client:
        site_id = send_site(client, folder, console)
        if not run:
            console.print(site_id, highlight=False)
            return
        job = client.create_job(site_id, options)
        console.print(f"site {site_id}, job {job.id}", highlight=False)
        watch(client, job.id, console)


def send_site(client: WibamClient, folder: SiteFolder, console: Console) -> str:
    """Create the site and upload its files, showing how that goes; returns the site's id."""
    site = client.create_site(folder.site)
    bars = Progress(
        TextColumn("{task.description:<24}"),
        BarColumn(bar_width=24),
        DownloadColumn(),
        TransferSpeedColumn(),
        console=console,
        disable=not console.is_terminal,
    )

    def bar(name: str, path: Path) -> UploadProgress:
        task = bars.add_task(name, total=path.stat().st_size)
        return lambda sent, size: bars.update(task, completed=sent, total=size)

    with bars:
        for camera_id, path in folder.recordings.items():
            client.upload_recording(site.id, camera_id, path, bar(camera_id, path))
        if "labels" in folder.assets:
            client.upload_labels(site.id, folder.assets["labels"], bar("labels", folder.assets["labels"]))
        if "detector" in folder.assets:
            client.upload_detector(site.id, folder.assets["detector"], bar("detector", folder.assets["detector"]))
    return site.id
