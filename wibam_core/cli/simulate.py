"""`wibam simulate`: record a simulated site into a site folder."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import pydantic
import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, TimeElapsedColumn

from wibam_core.errors import InvalidOption
from wibam_core.synthetic.options import SimulationOptions
from wibam_core.synthetic.recorder import record_site

_DEFAULTS = SimulationOptions()


def simulate(
    site_dir: Annotated[Path, typer.Argument(help="The site folder to write; it is created.")],
    seed: Annotated[int, typer.Option(help="Layout, traffic, cameras and clocks follow from it.")] = _DEFAULTS.seed,
    cameras: Annotated[int, typer.Option(help="Number of cameras, 2 to 8.")] = _DEFAULTS.cameras,
    seconds: Annotated[float, typer.Option(help="Length of the recordings.")] = _DEFAULTS.seconds,
    fps: Annotated[float, typer.Option(help="Frames per second.")] = _DEFAULTS.fps,
    width: Annotated[int, typer.Option(help="Image width in px.")] = _DEFAULTS.width_px,
    height: Annotated[int, typer.Option(help="Image height in px.")] = _DEFAULTS.height_px,
    regime: Annotated[str, typer.Option(help="'site': poles at the corners; 'ego': street level.")] = _DEFAULTS.regime,
    traffic: Annotated[
        str, typer.Option(help="'own': our own car-following; 'sumo': SUMO's, with the extra wibam[sumo].")
    ] = _DEFAULTS.traffic,
    density: Annotated[
        float, typer.Option(help="Traffic; 1 is about 6 vehicles a minute and lane.")
    ] = _DEFAULTS.traffic_density,
    parked: Annotated[int, typer.Option(help="Vehicles parked beside the road.")] = _DEFAULTS.parked,
    distortion: Annotated[bool, typer.Option(help="Mild barrel distortion in every lens.")] = _DEFAULTS.distortion,
    lens: Annotated[str, typer.Option(help="'pinhole', 'fisheye' or 'omnidirectional'.")] = _DEFAULTS.lens,
    cycle: Annotated[float, typer.Option(help="Length of the signal cycle in seconds.")] = _DEFAULTS.cycle_s,
    max_offset: Annotated[
        float, typer.Option(help="Recordings start at most so many seconds apart.")
    ] = _DEFAULTS.max_offset_s,
    max_drift: Annotated[
        float, typer.Option(help="Clocks are at most so many millionths off.")
    ] = _DEFAULTS.max_drift_ppm,
    drop_rate: Annotated[float, typer.Option(help="Share of frames that are lost.")] = _DEFAULTS.drop_rate,
    label_rate: Annotated[float, typer.Option(help="True boxes per second.")] = _DEFAULTS.label_rate_hz,
    workers: Annotated[int, typer.Option(help="Processes that render.")] = _DEFAULTS.workers,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the site that the folder holds.")] = False,
) -> None:
    """Record a simulated intersection: video files, calibration, and the exact truth."""
    values = {
        "seed": seed,
        "cameras": cameras,
        "seconds": seconds,
        "fps": fps,
        "width_px": width,
        "height_px": height,
        "regime": regime,
        "traffic": traffic,
        "traffic_density": density,
        "parked": parked,
        "distortion": distortion,
        "lens": lens,
        "cycle_s": cycle,
        "max_offset_s": max_offset,
        "max_drift_ppm": max_drift,
        "drop_rate": drop_rate,
        "label_rate_hz": label_rate,
        "workers": workers,
    }
    try:
        options = SimulationOptions.model_validate(values)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        field = str(first["loc"][0]) if first["loc"] else ""
        name = _option_name(field) if field else "the options"
        raise InvalidOption(f"{name}: {first['msg']}", hint="See `wibam simulate --help`.", option=name) from error
    console = Console()
    with Progress(
        *Progress.get_default_columns(), TimeElapsedColumn(), console=console, disable=not console.is_terminal
    ) as display:
        task = display.add_task("simulating", total=1.0)

        def show(fraction: float, message: str = "", **_: float) -> None:
            display.update(task, completed=fraction, description=message or "simulating")

        site = record_site(site_dir, options, show, overwrite=force)
    found = f"{site.name}: {len(site.cameras)} recordings in {site_dir}"
    console.print(escape(found), highlight=False, soft_wrap=True)


def _option_name(field: str) -> str:
    """What a person types for a field of `SimulationOptions`, e.g. ``--cycle`` for ``cycle_s``."""
    name = "density" if field == "traffic_density" else re.sub("_(s|px|ppm|hz)$", "", field)
    return "--" + name.replace("_", "-")
