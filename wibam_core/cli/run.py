"""`wibam run`: the whole pipeline on a site folder, without any service."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from wibam_core.artifacts.catalogue import made_by
from wibam_core.cli.display import StageDisplay, print_overlap, print_unclaimed
from wibam_core.cli.foretell import foretold, print_foretold
from wibam_core.config import PipelineConfig
from wibam_core.errors import InvalidOption
from wibam_core.stages.graph import STAGES, downstream, plan
from wibam_core.stages.runner import SiteFolder, StageUpdate, run_pipeline
from wibam_core.stages.store import StageStore


def parse_options(assignments: list[str]) -> dict[str, Any]:
    """``["finetune.steps=200", "sync.method=none"]`` as nested options; values are JSON or plain text.

    Raises:
        InvalidOption: if an assignment has no stage, no name or no value.
    """
    options: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        stage, dot, key = name.partition(".")
        if not (equals and dot and key):
            raise InvalidOption(f"{assignment!r} is not of the form stage.option=value", option=assignment)
        try:
            value = json.loads(text)
        except json.JSONDecodeError:
            value = text
        options.setdefault(stage, {})[key] = value
    return options


def run(
    site_dir: Annotated[Path, typer.Argument(help="A site folder: site.json and recordings/.")] = Path(),
    out: Annotated[Path | None, typer.Option(help="Where stage outputs go. Default: SITE_DIR/outputs.")] = None,
    option: Annotated[list[str] | None, typer.Option("--set", help="An option, e.g. finetune.steps=200.")] = None,
    until: Annotated[str | None, typer.Option(help="Stop after this stage.")] = None,
    restart_from: Annotated[str | None, typer.Option(help="Run this stage and all after it again.")] = None,
    dry_run: Annotated[bool, typer.Option(help="Only say which stages would run.")] = False,
    show_config: Annotated[bool, typer.Option(help="Print all options with these values set, and stop.")] = False,
) -> None:
    """Fine-tune on a site folder: recordings in, model, metrics, tracks, conflicts and report out."""
    console = Console()
    config = PipelineConfig.parse(parse_options(option or []))
    if show_config:
        console.print_json(config.model_dump_json(indent=2))
        return
    if until is not None and until not in STAGES:
        downstream(until)
    folder = SiteFolder.load(site_dir)
    print_unclaimed(console, folder.unclaimed)
    store = StageStore(out or site_dir / "outputs")
    planned = plan(folder.site, config, folder.digests())
    again = downstream(restart_from) if restart_from is not None else ()
    if dry_run:
        for stage in planned:
            kept = store.find(stage.name, stage.hash) is not None and stage.name not in again
            state = "given" if stage.name in folder.given else "kept" if kept else "to run"
            console.print(f"{state:>7}  {STAGES[stage.name].title}", highlight=False)
        return
    for stage in planned:
        if stage.name in again:
            store.remove(stage.name, stage.hash)
    to_make = [stage.name for stage in planned if folder.made(stage, store) is None]
    expected = foretold(folder, config)
    print_foretold(console, expected, to_make, until)
    with StageDisplay(console) as display:

        def show(update: StageUpdate) -> None:
            display.update(
                update.stage,
                update.state,
                update.fraction,
                update.message,
                update.figures,
                update.seconds,
                update.warnings,
                update.remaining_s,
                update.job_remaining_s,
            )
            if update.stage == "calibrate" and update.state in ("succeeded", "reused", "given"):
                calibrated = next(stage for stage in planned if stage.name == "calibrate")
                print_overlap(console, folder.made(calibrated, store))

        result = run_pipeline(folder, store, config, show, until=until, expected_s=expected)
    if "report" in result.summaries:
        from wibam_core.cli.tables import print_results

        print_results(console, result.outputs)
    else:
        last = list(result.summaries)[-1]
        console.print_json(data=result.summaries[last])
        for artifact in made_by(last):
            if result.outputs.has(artifact):
                console.print(
                    f"[dim]{artifact.title}: {escape(str(result.outputs.local(artifact)))}[/]", highlight=False
                )
