"""`wibam upload`: a site folder to a service."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from wibam_core.cli.run import parse_options
from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect, watch
from wibam_core.client import FileView, UploadProgress, WibamClient
from wibam_core.jobs.records import Purpose
from wibam_core.stages.runner import SiteFolder
from wibam_core.stages.store import sha256_of


def upload(
    site_dir: Annotated[Path, typer.Argument(help="A site folder: site.json and recordings/.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
    site: Annotated[
        str | None,
        typer.Option(help="Bring this site of the service up to date: its description, and the files that differ."),
    ] = None,
    run: Annotated[bool, typer.Option("--run", help="Start a job, and watch it.")] = False,
    option: Annotated[list[str] | None, typer.Option("--set", help="With --run: e.g. finetune.steps=200.")] = None,
) -> None:
    """Send a site and its files to a service. A broken connection is taken up where it broke."""
    console = Console()
    options = parse_options(option or [])
    folder = SiteFolder.load(site_dir)
    with connect(url, token) as client:
        site_id = send_site(client, folder, console, site)
        if not run:
            console.print(site_id, highlight=False)
            return
        job = client.create_job(site_id, options)
        console.print(f"site {site_id}, job {job.id}", highlight=False)
        watch(client, job.id, console)


def send_site(client: WibamClient, folder: SiteFolder, console: Console, site_id: str | None = None) -> str:
    """Describe the site and upload its files, showing how that goes; returns the site's id.

    With ``site_id``, that site is described anew, and only files that the service does not have yet are sent.
    """
    site = client.create_site(folder.site) if site_id is None else client.replace_site(site_id, folder.site)
    there = {} if site_id is None else {(file.purpose, file.camera or ""): file for file in client.files(site_id)}
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
            if not _is(path, there.get((Purpose.RECORDING, camera_id))):
                client.upload_recording(site.id, camera_id, path, bar(camera_id, path))
        labels, detector = folder.assets.get("labels"), folder.assets.get("detector")
        if labels is not None and not _is(labels, there.get((Purpose.LABELS, ""))):
            client.upload_labels(site.id, labels, bar("labels", labels))
        if detector is not None and not _is(detector, there.get((Purpose.DETECTOR, ""))):
            client.upload_detector(site.id, detector, bar("detector", detector))
    return site.id


def _is(path: Path, file: FileView | None) -> bool:
    """Whether the service's file is this one."""
    return file is not None and file.size_bytes == path.stat().st_size and file.sha256 == sha256_of(path)
