"""`wibam models`: the networks that a service keeps, and runs of them on new footage."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from wibam_core.cli.display import print_rows, to_minute
from wibam_core.cli.run import parse_options
from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect
from wibam_core.cli.service import watch as watch_job
from wibam_core.client import ModelView
from wibam_core.documents.base import MeanSd
from wibam_core.documents.metrics import Significance

app = typer.Typer(help="Keep a site's networks, and run them on new footage.", no_args_is_help=True)
ModelId = Annotated[str, typer.Argument(help="The id of a model.")]
SiteId = Annotated[str, typer.Argument(help="The id of a site.")]


@app.command("list")
def list_models(
    url: Url = DEFAULT_URL,
    token: Token = "",
    site: Annotated[str | None, typer.Option(help="Of this site alone.")] = None,
) -> None:
    """List models, the newest first."""
    with connect(url, token) as client:
        models = client.models(site)
    rows = (
        (model.id, model.site_id, str(model.version), model.state.value, model.name, to_minute(model.created_at))
        for model in models
    )
    print_rows(("model", "site"), ("version", "state", "name", "made (UTC)"), rows)


@app.command()
def show(model_id: ModelId, url: Url = DEFAULT_URL, token: Token = "") -> None:
    """Show a model's card."""
    console = Console()
    with connect(url, token) as client:
        model = client.model(model_id)
    for title, text in _card(model):
        console.print(f"[dim]{title:>14}[/]  {escape(text)}", highlight=False)


@app.command()
def add(
    site_id: SiteId,
    file: Annotated[Path, typer.Argument(help="A network, as safetensors.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
    name: Annotated[str, typer.Option(help="What you call it.")] = "",
) -> None:
    """Send a network of your own."""
    with connect(url, token) as client:
        Console().print(client.keep_model(site_id, file, name).id, highlight=False)


@app.command()
def promote(model_id: ModelId, url: Url = DEFAULT_URL, token: Token = "") -> None:
    """Make a model the one to use for its site."""
    _change(model_id, "promoted", url, token)


@app.command()
def retire(model_id: ModelId, url: Url = DEFAULT_URL, token: Token = "") -> None:
    """Keep a model for the record alone."""
    _change(model_id, "retired", url, token)


@app.command()
def download(
    model_id: ModelId,
    out: Annotated[Path, typer.Argument(help="The file to write: .safetensors or .onnx.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
) -> None:
    """Download a model; its file carries its card."""
    format = "onnx" if out.suffix == ".onnx" else "safetensors"
    with connect(url, token) as client:
        Console().print(str(client.download_kept_model(model_id, out, format)), highlight=False)


@app.command()
def run(
    model_id: ModelId,
    footage: Annotated[list[str], typer.Argument(help="Files, each as CAMERA=FILE; several of a camera in any order.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
    started: Annotated[
        list[str] | None,
        typer.Option(help="When a file began, in the order of the files: 2026-07-01T08:00:00+02:00. For all, or none."),
    ] = None,
    continues: Annotated[str | None, typer.Option(help="The run before, whose road users are followed on.")] = None,
    option: Annotated[list[str] | None, typer.Option("--set", help="An option, e.g. track.rate_hz=5.")] = None,
    wait: Annotated[bool, typer.Option(help="Show the run until it has ended.")] = True,
) -> None:
    """Send footage, and run a model on it: tracks and conflicts, without training."""
    console = Console()
    pairs = [_camera_and_file(item) for item in footage]
    times = started or [""] * len(pairs)
    if len(times) != len(pairs):
        raise typer.BadParameter(f"{len(times)} times for {len(pairs)} files", param_hint="--started")
    with connect(url, token) as client:
        site_id = client.model(model_id).site_id
        files = [
            client.upload_footage(site_id, camera, path, time)
            for (camera, path), time in zip(pairs, times, strict=True)
        ]
        job = client.create_run(model_id, files, parse_options(option or []), continues=continues)
        console.print(job.id, highlight=False)
        if wait:
            job = watch_job(client, job.id, console)
            console.print(f"{job.id}: {job.state}", highlight=False)


@app.command()
def compare(
    first: ModelId,
    second: Annotated[str, typer.Argument(help="The id of another model.")],
    url: Url = DEFAULT_URL,
    token: Token = "",
) -> None:
    """Compare two models on the instants that neither learned from."""
    console = Console()
    with connect(url, token) as client:
        found = client.compare_models(first, second)
    console.print(
        f"{found.instants} held-out instants, {found.from_s:.1f} to {found.to_s:.1f} s, {found.frames} frames",
        highlight=False,
    )
    rows = [
        (
            "IoU in other views",
            *_three(found.first.consistency.other_views, found.second.consistency.other_views, found.other_views),
        )
    ]
    if found.first.figures is not None and found.second.figures is not None and found.significance is not None:
        for name, title in (("bev_iou", "BEV IoU"), ("ate_m", "ATE (m)"), ("aoe_deg", "AOE (deg)")):
            of = (getattr(found.first.figures, name), getattr(found.second.figures, name), found.significance[name])
            rows.append((title, *_three(*of)))
    print_rows(("figure",), ("first", "second", "difference (95 %)"), rows)
    for caution in found.cautions:
        console.print(f"[yellow]caution[/] {escape(caution)}", highlight=False)


@app.command()
def delete(model_id: ModelId, url: Url = DEFAULT_URL, token: Token = "") -> None:
    """Delete a model. What it found stays."""
    with connect(url, token) as client:
        client.delete_model(model_id)


def _three(first: MeanSd, second: MeanSd, test: Significance) -> tuple[str, str, str]:
    means = ["–" if one.mean is None else f"{one.mean:.3f}" for one in (first, second)]
    if test.difference is None:
        return means[0], means[1], "–"
    if test.low is None or test.high is None:
        return means[0], means[1], f"{test.difference:+.3f} (too few vehicles)"
    return means[0], means[1], f"{test.difference:+.3f} ({test.low:+.3f} to {test.high:+.3f})"


def _camera_and_file(text: str) -> tuple[str, Path]:
    camera, _, file = text.partition("=")
    if not camera or not file:
        raise typer.BadParameter(f"{text!r} is not CAMERA=FILE", param_hint="FOOTAGE")
    return camera, Path(file)


def _change(model_id: str, state: str, url: str, token: str) -> None:
    with connect(url, token) as client:
        model = client.change_model(model_id, state=state)
    Console().print(f"{model.id}: version {model.version}, {model.state.value}", highlight=False)


def _card(model: ModelView) -> list[tuple[str, str]]:
    about, card = model.about, model.about.card
    rows = [
        ("model", f"{model.id}, version {model.version}, {model.state.value}"),
        ("name", model.name),
        ("site", model.site_id if about.site_name is None else f"{about.site_name} ({model.site_id})"),
        ("job", model.job_id or "none: it was uploaded"),
        ("cameras", ", ".join(about.cameras) or "unknown"),
        ("family", card.family),
        ("classes", ", ".join(card.classes)),
        ("places by", card.decode),
        ("licence", card.licence or "none stated"),
        ("file", f"{model.size_bytes / 1e6:.1f} MB, SHA-256 {model.sha256}"),
    ]
    if about.parent is not None:
        known = f" ({about.parent.model_id})" if about.parent.model_id else ""
        rows.append(("comes from", f"{about.parent.name}{known}"))
    if about.training is not None:
        instants = ", ".join(f"{name} {count}" for name, count in about.training.instants.items())
        rows.append(("learned from", f"{about.training.frames} pictures; instants: {instants}"))
    if about.metrics is not None:
        for name, consistency in about.metrics.self_consistency.items():
            iou = consistency.other_views
            if iou.mean is not None:
                spread = "" if iou.sd is None else f" ± {iou.sd:.3f}"
                rows.append(("other views", f"{name}: IoU {iou.mean:.3f}{spread} over {consistency.pairs} pairs"))
        if about.metrics.finetuned is not None and about.metrics.finetuned.bev_iou.mean is not None:
            bev = about.metrics.finetuned.bev_iou
            rows.append(("hand labels", f"BEV IoU {bev.mean:.3f}, s.d. {bev.sd or 0:.3f}"))
    return rows
