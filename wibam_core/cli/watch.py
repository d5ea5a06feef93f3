"""`wibam watch`: a folder into which recorders put files, each run through a network as it is complete."""

from __future__ import annotations

import json
import re
import time
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from wibam_core.cli.run import parse_options
from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect
from wibam_core.client import WibamClient
from wibam_core.errors import InputError, WibamError

#: Beside the footage: which files were run, and in which run.
_DONE = ".wibam-watched.json"
_VIDEO = {".mp4", ".mkv", ".mov", ".ts", ".m4v", ".avi", ".webm"}
#: A time in a file's name, as recorders write it: 20260701-080000, 2026-07-01T08_00_00, ...
_TIME = re.compile(r"(?<!\d)(20\d{2})[-_.]?(\d{2})[-_.]?(\d{2})[-_.T ]{0,3}(\d{2})[-_.:h]?(\d{2})[-_.:m]?(\d{2})(?!\d)")


@dataclass(frozen=True)
class Arrived:
    """A complete file of a camera, and when it began."""

    camera: str
    path: Path
    started: datetime


def watch(
    folder: Annotated[Path, typer.Argument(help="With a folder for each camera, named as the site names it.")],
    model: Annotated[str | None, typer.Option(help="The id of a model. Default: the site's promoted one.")] = None,
    site: Annotated[str | None, typer.Option(help="The id of a site, where no model is named.")] = None,
    url: Url = DEFAULT_URL,
    token: Token = "",
    utc_offset: Annotated[float, typer.Option(help="Hours from UTC of the times in the files' names.")] = 0.0,
    quiet: Annotated[float, typer.Option(help="A file is complete once it has not grown for so many seconds.")] = 30.0,
    option: Annotated[list[str] | None, typer.Option("--set", help="An option, e.g. track.rate_hz=5.")] = None,
    once: Annotated[bool, typer.Option("--once", help="Deal with what is there, then stop.")] = False,
) -> None:
    """Run a network on every file that arrives in a folder, for months.

    A file's name says when it began, as recorders write it (north/2026-07-01_08-00-00.mp4). Files of a camera are run
    in order, each going on with the one before, so that road users keep their ids. What was run is noted in the folder;
    a file whose run fails is noted, too, and not tried again.
    """
    console = Console()
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder", hint="Give the folder that the recorders write to.")
    options = parse_options(option or [])
    with connect(url, token) as client:
        model_id, site_id = _model(client, model, site)
        done = _read(folder)
        while True:
            for arrived in arrivals(folder, set(done), quiet, timedelta(hours=utc_offset), time.time()):
                try:
                    done[_name(folder, arrived.path)] = _run(client, model_id, site_id, arrived, done, folder, options)
                except WibamError as error:
                    console.print(f"[red]{escape(arrived.path.name)}: {escape(error.message)}[/]", highlight=False)
                    console.print(escape(error.hint), highlight=False)
                    if once:
                        raise
                    break  # files of a camera are run in order: this one is tried again
                _write(folder, done)
                noted = done[_name(folder, arrived.path)]
                said = f": {noted['failed']}" if "failed" in noted else ""
                console.print(escape(f"{_name(folder, arrived.path)}: {noted['run']}{said}"), highlight=False)
            if once:
                return
            time.sleep(min(max(quiet / 3, 1.0), 10.0))


def arrivals(folder: Path, done: set[str], quiet_s: float, utc_offset: timedelta, now: float) -> list[Arrived]:
    """Complete files that were not run yet, by time, then by camera.

    Args:
        folder: with a folder for each camera.
        done: their names below the folder.
        quiet_s: a file that has grown lately may grow on.
        utc_offset: of the times in the names.
        now: Unix seconds.

    Raises:
        InputError: a file's name does not say when it began.
    """
    found = []
    for path in sorted(folder.glob("*/*")):
        if path.suffix.lower() not in _VIDEO or path.name.startswith(".") or _name(folder, path) in done:
            continue
        facts = path.stat()
        if path.is_file() and facts.st_size and now - facts.st_mtime >= quiet_s:
            found.append(Arrived(path.parent.name, path, began(path.name, utc_offset)))
    return sorted(found, key=lambda one: (one.started, one.camera, one.path.name))


def began(name: str, utc_offset: timedelta) -> datetime:
    """When a file began, as its name says.

    Raises:
        InputError: it does not.
    """
    match = _TIME.search(name)
    try:
        if match is None:
            raise ValueError
        return datetime(*(int(part) for part in match.groups()), tzinfo=UTC) - utc_offset  # type: ignore[misc,arg-type]
    except ValueError:
        raise InputError(
            f"the name {name!r} does not say when the file began",
            hint="Let the recorder write the time into it, like 2026-07-01_08-00-00.mp4.",
        ) from None


def _model(client: WibamClient, model: str | None, site: str | None) -> tuple[str, str]:
    if model is not None:
        return model, client.model(model).site_id
    if site is None:
        raise InputError("neither a model nor a site is named", hint="Give --model, or --site with a promoted model.")
    promoted = [one for one in client.models(site) if one.state.value == "promoted"]
    if not promoted:
        raise InputError(f"no model of site {site} is promoted", hint="`wibam models promote MODEL`, or give --model.")
    return promoted[0].id, site


def _run(
    client: WibamClient,
    model_id: str,
    site_id: str,
    arrived: Arrived,
    done: dict[str, dict[str, Any]],
    folder: Path,
    options: dict[str, Any],
) -> dict[str, Any]:
    """Send one file and wait for its run; who is in view at its beginning keeps the id of the camera's run before."""
    file_id = client.upload_footage(site_id, arrived.camera, arrived.path, arrived.started.isoformat())
    before = [
        one
        for one in done.values()
        if (one["camera"], one["model"]) == (arrived.camera, model_id) and "failed" not in one
    ]
    latest = max(before, key=lambda one: str(one["started"]), default=None)
    goes_on = latest is not None and latest["started"] < arrived.started.isoformat()
    key = f"{model_id}-{file_id}"
    run = client.create_run(
        model_id,
        [file_id],
        options,
        continues=latest["run"] if goes_on and latest is not None else None,
        name=_name(folder, arrived.path),
        idempotency_key=key,
    )
    ended = client.wait(run.id, interval_s=2.0)
    noted = {"run": run.id, "camera": arrived.camera, "model": model_id, "started": arrived.started.isoformat()}
    return noted | ({} if ended.error is None else {"failed": ended.error.message})


def _name(folder: Path, path: Path) -> str:
    return path.relative_to(folder).as_posix()


def _read(folder: Path) -> dict[str, dict[str, Any]]:
    try:
        return dict(json.loads((folder / _DONE).read_text(encoding="utf-8")))
    except FileNotFoundError:
        return {}
    except ValueError as error:
        raise InputError(
            f"{folder / _DONE} cannot be read: {error}", hint="Remove it to run all files of the folder again."
        ) from error


def _write(folder: Path, done: dict[str, dict[str, Any]]) -> None:
    partial = folder / f"{_DONE}.tmp"
    partial.write_text(json.dumps(done, indent=1), encoding="utf-8")
    partial.replace(folder / _DONE)
