"""`wibam weights`: files of weights that a user brings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from wibam_core.networks.dla34.convert import LICENCE_NOTE, convert_checkpoint

app = typer.Typer(help="Bring weights of your own.", no_args_is_help=True)


@app.command()
def convert(
    source: Annotated[
        Path, typer.Argument(metavar="IN", help="CenterTrack's .pth (nuScenes 3D detection, DLA-34) or WIBAM's .ckpt.")
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT.safetensors", help="Where the converted weights go.")],
) -> None:
    """Convert a checkpoint to a file that `wibam track --weights` takes. Nothing in the checkpoint is run."""
    console = Console()
    found = convert_checkpoint(source, out)
    numbers = sum(value.numel() for value in found.state.values())
    said = [f"{len(found.state)} tensors, {numbers / 1e6:.1f} million numbers"]
    if found.prefix:
        said.append(f"the prefix {found.prefix} taken off their names")
    if found.dropped:
        said.append(f"heads that nothing here reads left out: {', '.join(found.dropped)}")
    console.print(escape("; ".join(said)), highlight=False)
    console.print(f"SHA-256 of {escape(source.name)}: {found.sha256}", highlight=False, soft_wrap=True)
    console.print(f"[yellow]{escape(LICENCE_NOTE)}[/]", highlight=False, soft_wrap=True)
    console.print(f"[bold]{escape(str(out))}[/]", highlight=False, soft_wrap=True)
