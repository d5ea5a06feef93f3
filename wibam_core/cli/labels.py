"""`wibam labels`: hand labels of a service's footage, in and out, and how far two people agree."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect
from wibam_core.documents.base import MeanSd
from wibam_core.errors import Conflict, InputError

app = typer.Typer(help="Fetch and send hand labels, and compare two people's.", no_args_is_help=True)
JobId = Annotated[str, typer.Argument(help="The id of a job on the footage.")]
LabelSet = Annotated[str, typer.Option("--set", help="Whose labels: two people who compare use two sets.")]
#: Labels of a file are an instant's where they are at most so far apart: times in files may be rounded.
_SAME_NS = 1_000_000


@app.command()
def get(
    job_id: JobId,
    url: Url = DEFAULT_URL,
    token: Token = "",
    out: Annotated[Path, typer.Option(help="A file, or a folder to put it into under its own name.")] = Path(),
    format: Annotated[str, typer.Option(help="parquet, json, or an exchange format such as coco.")] = "parquet",
    label_set: LabelSet = "main",
) -> None:
    """Fetch the finished labels as a file."""
    with connect(url, token) as client:
        written = client.download_labels(job_id, out, format, label_set)
    Console().print(f"[bold]{escape(str(written))}[/]", highlight=False, soft_wrap=True)


@app.command()
def put(
    job_id: JobId,
    file: Annotated[Path, typer.Argument(help="A labels file: Parquet or JSON.")],
    author: Annotated[str, typer.Option(help="Who made them.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
    label_set: LabelSet = "main",
    replace: Annotated[bool, typer.Option("--replace", help="Also where somebody has labelled already.")] = False,
) -> None:
    """Send a file of labels, as if each of its instants had been labelled and finished in the browser."""
    from wibam_core.formats.labels import read_labels
    from wibam_core.labelling.labels import hand_labels

    given = [hand_labels(one) for one in read_labels(file)]
    with connect(url, token) as client:
        times = client.instants(job_id)
        nearest = {one.time_ns: min(times, key=lambda time_ns: abs(time_ns - one.time_ns), default=0) for one in given}
        fitting = [one for one in given if times and abs(nearest[one.time_ns] - one.time_ns) <= _SAME_NS]
        if not fitting:
            raise InputError(
                f"none of the {len(given)} instants of {file.name} is one of job {job_id}",
                hint="Times are those of the reference camera's clock: GET /v1/jobs/{id}/instants lists the job's.",
            )
        placed = [one.model_copy(update={"time_ns": nearest[one.time_ns]}) for one in fitting]
        versions = {one.time_ns: client.labels(job_id, one.time_ns, label_set)[1] for one in placed}
        taken = sum(version > 0 for version in versions.values())
        if taken and not replace:
            raise Conflict(
                f"{taken} of these instants are labelled in the set {label_set!r} already; nothing was sent",
                hint="Use another --set, or --replace: earlier versions are kept.",
            )
        for one in placed:
            client.save_labels(job_id, one, author, versions[one.time_ns], label_set)
    left_out = len(given) - len(placed)
    Console().print(
        f"{len(placed)} instants are labelled in the set {escape(label_set)}"
        + (f"; {left_out} of the file are none of the job's" if left_out else ""),
        highlight=False,
    )


@app.command()
def agreement(
    job_id: JobId,
    first: Annotated[str, typer.Argument(help="Name of a set.")],
    second: Annotated[str, typer.Argument(help="Name of another.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
) -> None:
    """Compare two people's labels over the instants that both have finished."""
    with connect(url, token) as client:
        found = client.agreement(job_id, first, second)
    table = Table("", "mean", "sd", box=None)
    rows: tuple[tuple[str, MeanSd, int], ...] = (
        ("BEV IoU", found.bev_iou, 3),
        ("3D IoU", found.iou_3d, 3),
        ("distance of centres, m", found.ate_m, 3),
        ("1 - overlap of sizes", found.ase, 3),
        ("difference of headings, deg", found.aoe_deg, 2),
        ("difference of visibility", found.visibility, 3),
    )
    for title, value, digits in rows:
        table.add_row(title, *("-" if one is None else f"{one:.{digits}f}" for one in (value.mean, value.sd)))
    console = Console()
    console.print(table)
    same = "-" if found.same_class is None else f"{found.same_class:.0%}"
    console.print(
        f"{found.instants} instants, {found.pairs} vehicles of both, {found.only_first} only in {escape(first)}, "
        f"{found.only_second} only in {escape(second)}; same class: {same}",
        highlight=False,
        soft_wrap=True,
    )
