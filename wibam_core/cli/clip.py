"""`wibam clip`: a stretch of a job's results as a video."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, TimeElapsedColumn

from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect
from wibam_core.documents.clips import ClipFacts, ClipSpec
from wibam_core.errors import InputError, InvalidOption
from wibam_core.road_users import RoadUserClass


class ClipColour(StrEnum):
    """What colours say."""

    CLASS = "class"
    SPEED = "speed"
    TRACK = "track"


def clip(
    job_or_folder: Annotated[str, typer.Argument(help="The id of a job, or a site folder that `wibam run` worked on.")],
    start: Annotated[float, typer.Argument(help="From this second of the reference clock on.")],
    end: Annotated[float, typer.Argument(help="Up to this second of the reference clock.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
    out: Annotated[Path, typer.Option(help="The file to write.")] = Path("clip.mp4"),
    vehicle_class: Annotated[list[RoadUserClass] | None, typer.Option("--class", help="Of these classes.")] = None,
    min_speed: Annotated[float | None, typer.Option(help="At least this fast, in m/s.")] = None,
    polygon: Annotated[str | None, typer.Option(help="Those inside corners x1,y1;x2,y2;... in m.")] = None,
    colour: Annotated[ClipColour, typer.Option(help="What colours say.")] = ClipColour.CLASS,
    trail: Annotated[float, typer.Option(help="Length of the trails in the plan, in s.")] = 3.0,
    boxes: Annotated[bool, typer.Option(help="Draw boxes into the views.")] = True,
    speed: Annotated[float, typer.Option(help="2 is twice as fast as it happened.")] = 1.0,
    width: Annotated[int, typer.Option(help="Of the video, in px.")] = 1600,
    outputs: Annotated[Path | None, typer.Option(help="Of a folder: what `wibam run` had as --out.")] = None,
) -> None:
    """Render a stretch of a job as a video: the plan and all cameras' views, with the road users drawn in."""
    console = Console()
    try:
        spec = ClipSpec(
            start_ns=round(start * 1e9),
            end_ns=round(end * 1e9),
            classes=tuple(vehicle_class or ()),
            min_speed_mps=min_speed,
            polygon=_corners(polygon),
            colour=colour.value,
            trail_s=trail,
            boxes=boxes,
            speed=speed,
            width_px=width,
        )
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise InvalidOption(f"{where}: {first['msg']}".removeprefix(": "), hint="See `wibam clip --help`.") from error
    columns = (*Progress.get_default_columns(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as display:
        task = display.add_task("rendering", total=1.0)

        def show(fraction: float, message: str = "", **_: float) -> None:
            display.update(task, completed=fraction, description=message or "rendering")

        facts: ClipFacts | None
        if Path(job_or_folder).is_dir():
            from wibam_core.clips.render import ClipRenderer
            from wibam_core.stages.runner import SiteFolder, latest
            from wibam_core.stages.store import StageStore

            folder = SiteFolder.load(Path(job_or_folder))
            made = latest(folder, StageStore(outputs or Path(job_or_folder) / "outputs"))
            partial = out.with_name(out.name + ".part")
            facts = ClipRenderer(made, spec).render(partial, show)
            partial.replace(out)
        else:
            with connect(url, token) as client:
                asked = client.create_clip(job_or_folder, spec)
                done = client.wait_for_clip(job_or_folder, asked.id, lambda view: show(view.fraction, view.message))
                done.raise_for_failure()
                client.download_clip(job_or_folder, asked.id, out)
                facts = done.facts
    _say(console, out, facts)


def _say(console: Console, out: Path, facts: ClipFacts | None) -> None:
    console.print(f"[bold]{escape(str(out))}[/]", highlight=False, soft_wrap=True)
    if facts is not None:
        size = f"{facts.width_px}x{facts.height_px} px"
        console.print(f"{facts.frames} frames of {size}; road users: {facts.road_users}", highlight=False)


def _corners(polygon: str | None) -> tuple[tuple[float, float], ...]:
    """Raises:
    InputError: it is no list of points.
    """
    if polygon is None:
        return ()
    try:
        corners = [tuple(float(part) for part in corner.split(",")) for corner in polygon.split(";")]
        return tuple((x, y) for x, y in corners)
    except ValueError:
        raise InputError(f"the polygon {polygon!r} is no list of corners", hint="Give x1,y1;x2,y2;... in m.") from None
