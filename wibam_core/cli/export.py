"""`wibam export`: what a job has made, in a format of others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape

from wibam_core.cli.display import list_table, print_list
from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect
from wibam_core.documents.exports import BoxSource, ExportOffer

if TYPE_CHECKING:  # formats take long to import, and a service has its own
    from wibam_core.exports import ExportSource


def export(
    job_or_folder: Annotated[str, typer.Argument(help="The id of a job, or a site folder that `wibam run` worked on.")],
    format: Annotated[str | None, typer.Argument(help="The format's name; left out, all are listed.")] = None,
    url: Url = DEFAULT_URL,
    token: Token = "",
    out: Annotated[Path, typer.Option(help="A file, or a folder to put it into under its own name.")] = Path(),
    boxes: Annotated[BoxSource, typer.Option(help="3D boxes of the fits, or of the network.")] = BoxSource.FITS,
    outputs: Annotated[Path | None, typer.Option(help="Of a folder: what `wibam run` had as --out.")] = None,
) -> None:
    """Write what a job has made in a format of others: one file, or a zip archive of several."""
    console = Console()
    site_dir = Path(job_or_folder)
    if site_dir.is_dir():
        source = _source(site_dir, outputs)
        if format is None:
            from wibam_core.exports import offers

            _print_offers(console, offers(source))
            return
        written = _write(source, format, boxes, out, site_dir.resolve().name)
    else:
        with connect(url, token) as client:
            if format is None:
                _print_offers(console, client.exports(job_or_folder))
                return
            written = client.download_export(job_or_folder, format, out, boxes)
    console.print(f"[bold]{escape(str(written))}[/]", highlight=False, soft_wrap=True)


def _print_offers(console: Console, offers: Sequence[ExportOffer]) -> None:
    table = list_table("format", others=("", "missing", "loses"))
    for offer in offers:
        table.add_row(offer.name, offer.title, ", ".join(offer.missing).replace("_", " ") or "-", offer.loses)
    print_list(console, table)


def _source(site_dir: Path, outputs: Path | None) -> ExportSource:
    from wibam_core.exports import ExportSource
    from wibam_core.stages.runner import SiteFolder, latest
    from wibam_core.stages.store import StageStore

    folder = SiteFolder.load(site_dir)
    artifacts = latest(folder, StageStore(outputs or site_dir / "outputs"))
    return ExportSource(folder.site, artifacts, folder.assets.get("labels"))


def _write(source: ExportSource, format: str, boxes: BoxSource, out: Path, name: str) -> Path:
    from wibam_core.exports import open_export

    with open_export(format, source, boxes) as opened:
        target = out / f"{name}-{opened.name}" if out.is_dir() else out
        partial = target.with_name(target.name + ".part")
        with partial.open("wb") as file:
            file.writelines(opened.blocks)
        partial.replace(target)
    return target
