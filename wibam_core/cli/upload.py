"""`wibam upload`: a site folder to a service."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from wibam_core.cli.display import print_unclaimed
from wibam_core.cli.run import parse_options
from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect, watch
from wibam_core.client import FileView, UploadProgress, WibamClient
from wibam_core.config import PipelineConfig
from wibam_core.errors import WibamError
from wibam_core.jobs.records import Purpose
from wibam_core.site import Site
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
    PipelineConfig.parse(options)  # before hours of sending
    folder = SiteFolder.load(site_dir)
    print_unclaimed(console, folder.unclaimed)
    with connect(url, token) as client:
        site_id = _describe(client, folder, site)
        console.print(site_id, highlight=False)
        try:
            _send_files(client, folder, console, site_id, anew=site is None)
        except WibamError as error:
            raise _with_continuation(error, site_dir, site_id) from error
        if not run:
            return
        job = client.create_job(site_id, options)
        console.print(f"job {job.id}", highlight=False)
        watch(client, job.id, console)


def send_site(client: WibamClient, folder: SiteFolder, console: Console) -> str:
    """Describe a new site and upload its files, showing how that goes; returns the site's id."""
    site_id = _describe(client, folder, None)
    _send_files(client, folder, console, site_id, anew=True)
    return site_id


def _describe(client: WibamClient, folder: SiteFolder, site_id: str | None) -> str:
    described = _listing(folder)
    site = client.create_site(described) if site_id is None else client.replace_site(site_id, described)
    return site.id


def _listing(folder: SiteFolder) -> Site:
    """The site, with the names of a camera's files where they are several: in a folder they need not be listed."""
    cameras = []
    for camera in folder.site.cameras:
        recording = folder.recordings.get(camera.id)
        if recording is not None and len(recording.files) > 1:
            camera = camera.model_copy(update={"recordings": tuple(file.name for file in recording.files)})
        cameras.append(camera)
    return folder.site.model_copy(update={"cameras": tuple(cameras)})


def _send_files(client: WibamClient, folder: SiteFolder, console: Console, site_id: str, *, anew: bool) -> None:
    """Send the files that the service does not have yet; to a site made ``anew`` that is all of them.

    Raises:
        WibamError: of the kind that a file met; its message names the file.
    """
    several = {c: len(recording.files) > 1 for c, recording in folder.recordings.items()}
    there: dict[tuple[Purpose, str, str], FileView] = {}
    for file in [] if anew else client.files(site_id):
        camera_id = file.camera or ""
        there[file.purpose, camera_id, file.filename if several.get(camera_id) else ""] = file
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
        for camera_id, recording in folder.recordings.items():
            for part in recording.files:
                name = part.name if several[camera_id] else ""
                if not _is(part.path, there.get((Purpose.RECORDING, camera_id, name))):
                    with _naming(part.path):
                        shown = f"{camera_id} {name}".rstrip()
                        client.upload_recording(site_id, camera_id, part.path, bar(shown, part.path))
        sends = {"labels": client.upload_labels, "detector": client.upload_detector, "network": client.upload_network}
        for name, path in folder.assets.items():
            if not _is(path, there.get((Purpose(name), "", ""))):
                with _naming(path):
                    sends[name](site_id, path, bar(name, path))


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Let an error of the client name the file that it is about."""
    try:
        yield
    except WibamError as error:
        facts = error.to_dict()
        facts["message"] = f"{path.name} was not sent: {error.message}"
        facts["details"] = {**error.details, "file": path.name}
        raise WibamError.from_dict(facts) from error


def _with_continuation(error: WibamError, site_dir: Path, site_id: str) -> WibamError:
    """The same error, with a hint how to go on."""
    command = shlex.join(["wibam", "upload", str(site_dir), "--site", site_id])
    facts = error.to_dict()
    facts["hint"] = f"{error.hint} Then go on with `{command}`: files that arrived are not sent again.".strip()
    facts["details"] = {**error.details, "site": site_id}
    return WibamError.from_dict(facts)


def _is(path: Path, file: FileView | None) -> bool:
    """Whether the service's file is this one."""
    return file is not None and file.size_bytes == path.stat().st_size and file.sha256 == sha256_of(path)
