"""`wibam signals`: the traffic-light changes in one recording."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from wibam_core.config import SyncConfig
from wibam_core.errors import InputError, NoSignalChange
from wibam_core.site import SignalRegion
from wibam_core.sync.changes import SignalWatch
from wibam_core.sync.document import seen_change
from wibam_core.video.decode import OnePass, Watcher
from wibam_core.video.seeking import read_header

_USUAL = SyncConfig()


def signals(
    video: Annotated[Path, typer.Argument(help="A recording.")],
    region: Annotated[
        list[str],
        typer.Option(metavar="X,Y,W,H", help="A signal head in px of the recording; give the option once per head."),
    ],
    min_confidence: Annotated[
        float, typer.Option(help="Less certain changes are left out.", min=0, max=1)
    ] = _USUAL.min_confidence,
    min_lit_share: Annotated[
        float, typer.Option(help="A region that is clearly lit in fewer of its frames holds no signal.", min=0, max=1)
    ] = _USUAL.min_lit_share,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Print when traffic lights change in a recording: time s, from, to, confidence."""
    heads = [_parse_region(text, number) for number, text in enumerate(region, start=1)]
    header = read_header(video)
    watch = SignalWatch(video.stem, heads, header.width_px, header.height_px)
    OnePass(video, watcher=Watcher(watch.windows, (header.width_px, header.height_px), watch.add)).finish()
    found = [change for change in watch.changes(min_lit_share) if change.confidence >= min_confidence]
    console = Console()
    if as_json:
        console.print_json(json.dumps([seen_change(change).model_dump(exclude_none=True) for change in found]))
        return
    if not found:
        raise NoSignalChange(f"no signal change was seen in {video.name}")
    table = Table("time s", "± s", "from", "to", "confidence")
    if len(heads) > 1:
        table.add_column("region")
    for change in found:
        cells = [
            f"{change.time_ns / 1e9:.3f}",
            f"{change.half_interval_ns / 1e9:.3f}",
            change.before,
            change.after,
            f"{change.confidence:.2f}",
        ]
        table.add_row(*cells, *([change.signal_id] if len(heads) > 1 else []))
    console.print(table)


def _parse_region(text: str, number: int) -> SignalRegion:
    try:
        x, y, width, height = (float(part) for part in text.split(","))
    except ValueError:
        x = y = width = height = math.nan
    if not all(map(math.isfinite, (x, y, width, height))) or width <= 0 or height <= 0:
        raise InputError(
            f"--region {text!r} is not x,y,width,height", hint="For example --region 551,180,18,50, in pixels."
        )
    return SignalRegion(id=str(number), region=(x, y, width, height))
