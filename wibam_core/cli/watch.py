"""`wibam watch`: a folder into which recorders put files, each run through a network as it is complete.

Streams of cameras are recorded into the same folder (`adapters.stream_recorder`), and go the same way.
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path, PurePath
from types import FrameType
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from wibam_core.adapters.camera_stream import StreamAddress
from wibam_core.adapters.stream_recorder import StreamRecorder, is_recorded
from wibam_core.cli.run import parse_options
from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect
from wibam_core.client import WibamClient
from wibam_core.errors import InputError, WibamError
from wibam_core.video.name_times import time_in

#: Beside the footage: which files were run, and in which run.
_DONE = ".wibam-watched.json"
_VIDEO = {".mp4", ".mkv", ".mov", ".ts", ".m4v", ".avi", ".webm"}


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
    stream: Annotated[
        list[str] | None,
        typer.Option(
            help="A camera's stream to record, as CAMERA=rtsp://NAME:PASSWORD@HOST/PATH, or CAMERA=@FILE with the "
            "address in a file, so that other users of this machine do not see the password."
        ),
    ] = None,
    chunk_minutes: Annotated[float, typer.Option(help="Streams are cut into files about so long.", min=0.1)] = 10.0,
    keep_gb: Annotated[
        float, typer.Option(help="Files of a stream that wait may take so much; then the oldest are removed.", min=0.1)
    ] = 20.0,
    option: Annotated[list[str] | None, typer.Option("--set", help="An option, e.g. track.rate_hz=5.")] = None,
    once: Annotated[bool, typer.Option("--once", help="Deal with what is there, then stop.")] = False,
) -> None:
    """Run a network on every file that arrives in a folder, for months, and on streams of cameras.

    A file's name says when it began, as recorders write it (north/2026-07-01_08-00-00.mp4). Files of a camera are run
    in order, each going on with the one before, so that road users keep their ids. What was run is noted in the folder;
    a file whose run fails is noted, too, and not tried again. Files of streams are removed once they were run: the
    service has them.
    """
    console = Console()
    if stream and once:
        raise InputError("a stream has no end to wait for", hint="Leave --once out, or the streams.")
    if stream:
        folder.mkdir(parents=True, exist_ok=True)
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder", hint="Give the folder that the recorders write to.")
    options, addresses = parse_options(option or []), dict(_stream(text) for text in stream or [])
    signal.signal(signal.SIGTERM, _interrupt)
    with connect(url, token) as client, ExitStack() as recorders:
        model_id, site_id = _model(client, model, site)
        _check_cameras(addresses, client.site(site_id).cameras)
        watched = _Watched(folder, client, model_id, site_id, options, console)
        recording: list[StreamRecorder] = []
        for camera, address in addresses.items():
            say = partial(_say, console, camera)
            recording.append(StreamRecorder(address, folder / camera, 60 * chunk_minutes, round(keep_gb * 1e9), say))
            recorders.callback(recording[-1].stop)
        with suppress(KeyboardInterrupt):
            while True:
                for one in recording:
                    one.check()
                try:
                    watched.run_all(quiet, timedelta(hours=utc_offset))
                except WibamError as error:
                    if once:
                        raise
                    _say(console, "", f"{error.message} {error.hint}".strip())
                if once:
                    return
                time.sleep(min(max(quiet / 3, 1.0), 10.0))
        console.print("stopping ...")


class _Watched:
    """A folder, and what was run of it, which is noted there.

    Args:
        folder: with a folder for each camera.
        client, model_id, site_id, options: what files are run with.
        console: for what a person should know.
    """

    def __init__(
        self,
        folder: Path,
        client: WibamClient,
        model_id: str,
        site_id: str,
        options: dict[str, Any],
        console: Console,
    ) -> None:
        self._folder, self._client, self._console = folder, client, console
        self._model_id, self._site_id, self._options = model_id, site_id, options
        self._done = _read(folder)

    def run_all(self, quiet_s: float, utc_offset: timedelta) -> None:
        """Run what has arrived, one after the other.

        Raises:
            WibamError: one could not be run: it is tried again, since files of a camera are run in order.
        """
        for arrived in arrivals(self._folder, set(self._done), quiet_s, utc_offset, time.time()):
            name = _name(self._folder, arrived.path)
            try:
                noted = self._run(arrived, name)
            except FileNotFoundError:  # there was no room for it any more
                continue
            self._done[name] = noted
            if is_recorded(arrived.path):
                arrived.path.unlink(missing_ok=True)
                self._forget_before(arrived.camera)
            _write(self._folder, self._done)
            said = f": {noted['failed']}" if "failed" in noted else ""
            self._console.print(escape(f"{name}: {noted['run']}{said}"), highlight=False)

    def _run(self, arrived: Arrived, name: str) -> dict[str, Any]:
        """Send one file and wait for its run; who is in view at its beginning keeps the id of the run before."""
        client, started = self._client, arrived.started.isoformat(timespec="milliseconds")
        latest = self._latest(arrived.camera)
        goes_on = latest is not None and _time(latest) < arrived.started
        file_id = self._sent(arrived, started)
        run = client.create_run(
            self._model_id,
            [file_id],
            self._options,
            continues=latest["run"] if goes_on and latest is not None else None,
            name=name,
            idempotency_key=f"{self._model_id}-{file_id}",
        )
        ended = client.wait(run.id, interval_s=2.0)
        noted = {"run": run.id, "camera": arrived.camera, "model": self._model_id, "started": started}
        return noted | ({} if ended.error is None else {"failed": ended.error.message})

    def _sent(self, arrived: Arrived, started: str) -> str:
        """The file's id at the service, to which it may have been sent before this program was ended."""
        size = arrived.path.stat().st_size
        there = self._client.footage(
            self._site_id, arrived.camera, (arrived.started, arrived.started + timedelta(milliseconds=1))
        )
        for one in there:
            if (one.filename, one.size_bytes) == (arrived.path.name, size):
                return one.id
        return self._client.upload_footage(self._site_id, arrived.camera, arrived.path, started)

    def _latest(self, camera: str) -> dict[str, Any] | None:
        """Of the camera's runs of this model that went well, the latest one."""
        before = [
            one
            for one in self._done.values()
            if (one["camera"], one["model"]) == (camera, self._model_id) and "failed" not in one
        ]
        return max(before, key=_time, default=None)

    def _forget_before(self, camera: str) -> None:
        """Keep of what was recorded, and is gone from the folder, the note alone that the next run needs."""
        latest = self._latest(camera)
        self._done = {
            name: one
            for name, one in self._done.items()
            if one is latest or one["camera"] != camera or not is_recorded(Path(name)) or (self._folder / name).exists()
        }


def _stream(text: str) -> tuple[str, StreamAddress]:
    """CAMERA=ADDRESS, or CAMERA=@FILE. No message repeats an address: it may hold a password."""
    camera, _, address = text.partition("=")
    if address.startswith("@"):
        try:
            address = Path(address[1:]).read_text(encoding="utf-8").strip()
        except (OSError, ValueError) as error:
            raise InputError(
                f"the file with the address of {camera}'s stream cannot be read", hint="Give the file's path after =@."
            ) from error
    if "://" in camera or not camera:
        raise InputError("it is not said whose a stream is", hint="Write --stream CAMERA=rtsp://HOST/PATH.")
    return camera, StreamAddress.of(address)


def _check_cameras(addresses: Mapping[str, StreamAddress], known: Sequence[str]) -> None:
    unknown = [camera for camera in addresses if camera not in known]
    if unknown:
        raise InputError(
            f"the site has no camera {unknown[0]!r}", hint=f"It has {', '.join(known)}.", camera=unknown[0]
        )


def _say(console: Console, camera: str, text: str) -> None:
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S")
    console.print(escape(f"{now} {camera}{': ' if camera else ''}{text}"), highlight=False, soft_wrap=True)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _time(noted: Mapping[str, Any]) -> datetime:
    return datetime.fromisoformat(str(noted["started"]))


def arrivals(folder: Path, done: set[str], quiet_s: float, utc_offset: timedelta, now: float) -> list[Arrived]:
    """Complete files that were not run yet, by time, then by camera.

    Files that are recorded here get their names when they are complete; of others it is told by their not growing.

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
        if path.is_file() and facts.st_size and (is_recorded(path) or now - facts.st_mtime >= quiet_s):
            found.append(Arrived(path.parent.name, path, began(path.name, utc_offset)))
    return sorted(found, key=lambda one: (one.started, one.camera, one.path.name))


def began(name: str, utc_offset: timedelta) -> datetime:
    """When a file began, as its name says; one with a Z after its time is in UTC, whatever the offset of the others.

    Raises:
        InputError: it does not.
    """
    found = time_in(PurePath(name).stem)
    if found is None:
        raise InputError(
            f"the name {name!r} does not say when the file began",
            hint="Let the recorder write the time into it, like 2026-07-01_08-00-00.mp4.",
        )
    began, is_utc = found
    return began if is_utc else began - utc_offset


def _model(client: WibamClient, model: str | None, site: str | None) -> tuple[str, str]:
    if model is not None:
        return model, client.model(model).site_id
    if site is None:
        raise InputError("neither a model nor a site is named", hint="Give --model, or --site with a promoted model.")
    promoted = [one for one in client.models(site) if one.state.value == "promoted"]
    if not promoted:
        raise InputError(f"no model of site {site} is promoted", hint="`wibam models promote MODEL`, or give --model.")
    return promoted[0].id, site


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
