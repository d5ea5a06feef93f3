"""`wibam import`: a site folder of somebody else's data set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, TimeElapsedColumn

from wibam_core.errors import NotFound
from wibam_core.exchange.registry import READABLE


def import_data(
    format_name: Annotated[str, typer.Argument(metavar="FORMAT", help="What the data set is, e.g. wibam-dataset.")],
    folder: Annotated[Path, typer.Argument(help="The folder of the data set.")],
    site_dir: Annotated[Path, typer.Argument(help="The site folder to make: absent or empty.")],
) -> None:
    """Make a site of a data set, with its frames, calibration, 2D boxes, association, split and hand labels."""
    from wibam_core.stages.importing import NEEDED, import_site  # SciPy takes a third of a second to load

    able = {name: fmt for name, fmt in READABLE.items() if fmt.reads >= NEEDED}
    if format_name not in able:
        raise NotFound(f"no site can be made of {format_name!r}", hint=f"Formats for this: {', '.join(able)}.")
    console = Console()
    with Progress(
        *Progress.get_default_columns(), TimeElapsedColumn(), console=console, disable=not console.is_terminal
    ) as display:
        task = display.add_task("reading", total=1.0)

        def show(fraction: float, message: str = "", **_: float) -> None:
            display.update(task, completed=fraction, description=message or "importing")

        content = able[format_name].read(folder)
        found = import_site(content, site_dir, show)
    for note in (*content.notes, *found):
        console.print(escape(note), highlight=False, soft_wrap=True)
    console.print(escape(f"Now run: wibam run {site_dir}"), highlight=False, soft_wrap=True)
