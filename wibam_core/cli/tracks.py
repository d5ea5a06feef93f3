"""`wibam tracks`: the tracks of a job, as a file."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect
from wibam_core.road_users import RoadUserClass


class TrackFormat(StrEnum):
    """File formats."""

    CSV = "csv"
    PARQUET = "parquet"
    JSON = "json"


def tracks(
    job_id: Annotated[str, typer.Argument(help="The id of a job.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
    format: Annotated[TrackFormat, typer.Option(help="What to write.")] = TrackFormat.CSV,
    out: Annotated[Path | None, typer.Option(help="Where to. Default: JOB-tracks.FORMAT.")] = None,
    start: Annotated[float | None, typer.Option(help="From this second of the reference clock on.")] = None,
    end: Annotated[float | None, typer.Option(help="Up to this second of the reference clock.")] = None,
    bounds: Annotated[str | None, typer.Option(help="x_min,y_min,x_max,y_max in m.")] = None,
    polygon: Annotated[str | None, typer.Option(help="Corners x1,y1;x2,y2;... in m.")] = None,
    vehicle_class: Annotated[list[RoadUserClass] | None, typer.Option("--class", help="Of these classes.")] = None,
    track: Annotated[list[int] | None, typer.Option(help="These tracks.")] = None,
    min_speed: Annotated[float | None, typer.Option(help="At least this fast, in m/s.")] = None,
) -> None:
    """Download the 7DoF tracks of a job: one row per vehicle and instant."""
    target = out or Path(f"{job_id}-tracks.{format}")
    with connect(url, token) as client:
        client.download_tracks(
            job_id,
            target,
            format.value,
            start_ns=_ns(start),
            end_ns=_ns(end),
            bounds=bounds,
            polygon=polygon,
            vehicle_class=[cls.value for cls in vehicle_class or []],
            track_id=list(track or []),
            min_speed_mps=min_speed,
        )
    Console().print(f"[bold]{escape(str(target))}[/]", highlight=False, soft_wrap=True)


def _ns(seconds: float | None) -> int | None:
    return None if seconds is None else round(seconds * 1e9)
