"""`wibam watch`: a folder into which recorders put files, each run through a network as it is complete.

Streams of cameras are recorded into the same folder (`adapters.stream_recorder`), and go the same way.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from wibam_core.adapters.camera_stream import StreamAddress
from wibam_core.adapters.stream_recorder import StreamRecorder, disk_error
from wibam_core.adapters.watched_folder import WatchedFolder, alone_in
from wibam_core.cli.run import parse_options
from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect
from wibam_core.client import WibamClient
from wibam_core.errors import InputError, WibamError


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
    a file whose run fails or is cancelled is noted, too, and not tried again. Files of streams are removed once they
    were run: the service has them.
    """
    console = Console()
    if stream and once:
        raise InputError("a stream has no end to wait for", hint="Leave --once out, or the streams.")
    if stream:
        folder.mkdir(parents=True, exist_ok=True)
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder", hint="Give the folder that the recorders write to.")
    options, addresses = parse_options(option or []), _addresses(stream or [])
    signal.signal(signal.SIGTERM, _interrupt)
    with alone_in(folder), connect(url, token) as client, ExitStack() as recorders:
        model_id, site_id = _model(client, model, site)
        _check_cameras(addresses, client.site(site_id).cameras)
        recording: list[StreamRecorder] = []

        def check() -> None:
            for one in recording:
                one.check()

        watched = WatchedFolder(folder, client, model_id, site_id, options, partial(_say, console, ""), check)
        for camera, address in addresses.items():
            say = partial(_say, console, camera)
            recording.append(StreamRecorder(address, folder / camera, 60 * chunk_minutes, round(keep_gb * 1e9), say))
            recorders.callback(recording[-1].stop)
        with suppress(KeyboardInterrupt):
            while True:
                check()
                try:
                    watched.run_all(quiet, timedelta(hours=utc_offset))
                except (WibamError, OSError) as error:
                    check()
                    known = error if isinstance(error, WibamError) else disk_error(folder, error)
                    if once:
                        raise known from None
                    _say(console, "", f"{known.message} {known.hint}".strip())
                if once:
                    return
                time.sleep(min(max(quiet / 3, 1.0), 10.0))
        console.print("stopping ...")


def _addresses(texts: Sequence[str]) -> dict[str, StreamAddress]:
    """Each camera's address.

    Raises:
        InputError: one is none, or two are of one camera.
    """
    found: dict[str, StreamAddress] = {}
    for text in texts:
        camera, address = _stream(text)
        if camera in found:
            raise InputError(f"two streams are of camera {camera!r}", hint="Give one for each camera.", camera=camera)
        found[camera] = address
    return found


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


def _model(client: WibamClient, model: str | None, site: str | None) -> tuple[str, str]:
    if model is not None:
        return model, client.model(model).site_id
    if site is None:
        raise InputError("neither a model nor a site is named", hint="Give --model, or --site with a promoted model.")
    promoted = [one for one in client.models(site) if one.state.value == "promoted"]
    if not promoted:
        raise InputError(f"no model of site {site} is promoted", hint="`wibam models promote MODEL`, or give --model.")
    return promoted[0].id, site
