"""`wibam demo`: everything once, on a simulated intersection, the way a user would do it over HTTP."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, TimeElapsedColumn

from wibam_core.artifacts.artifact import Artifact
from wibam_core.artifacts.catalogue import CONFLICTS, METRICS, TRACKS
from wibam_core.cli.display import time_left
from wibam_core.cli.embedded import LOCK, EmbeddedService, exclusive
from wibam_core.cli.foretell import foretold_demo
from wibam_core.cli.run import parse_options
from wibam_core.cli.service import watch
from wibam_core.cli.tables import RESULTS, print_tables
from wibam_core.cli.upload import send_site
from wibam_core.client import JobView, WibamClient
from wibam_core.config import PipelineConfig
from wibam_core.errors import Conflict
from wibam_core.report.summary import summary
from wibam_core.stages.runner import SiteFolder
from wibam_core.synthetic.options import SimulationOptions

T = TypeVar("T")

#: Options that fit the whole thread into minutes on two cores; the service's own defaults are for real footage.
_QUICK: dict[str, dict[str, Any]] = {"finetune": {"steps": 350}, "track": {"rate_hz": 5.0}}


def demo(
    out: Annotated[Path, typer.Option(help="Where everything goes; an earlier demo there is replaced.")] = Path("demo"),
    seed: Annotated[int, typer.Option(help="Another seed is another intersection.")] = 13,
    seconds: Annotated[float, typer.Option(help="Length of the recordings.", min=20)] = 90.0,
    density: Annotated[float, typer.Option(help="Traffic; 1 is about 6 vehicles a minute and lane.")] = 1.2,
    option: Annotated[list[str] | None, typer.Option("--set", help="An option, e.g. finetune.steps=200.")] = None,
    keep: Annotated[bool, typer.Option(help="Leave the service and its pages up at the end, until Ctrl-C.")] = False,
) -> None:
    """Record a simulated intersection, upload it, fine-tune on it, and show what came out."""
    console = Console()
    options = {stage: dict(values) for stage, values in _QUICK.items()}
    for stage, values in parse_options(option or []).items():
        options.setdefault(stage, {}).update(values)
    _make_room(out)
    simulated = SimulationOptions(seed=seed, seconds=seconds, traffic_density=density, workers=2)
    expected_s = foretold_demo(simulated, PipelineConfig.parse(options))
    console.print(f"This will take about {time_left(expected_s)} on this machine.", highlight=False)
    spent: dict[str, float] = {}
    with EmbeddedService(out / "data") as service, WibamClient(service.url, service.token) as client:
        console.print(f"1. The service is up at {service.url}", highlight=False)
        console.print("2. Recording a simulated intersection with four cameras to video files", highlight=False)
        with _timed(spent, "simulate"):
            _record(out / "site", simulated, console)
        console.print("3. Uploading the recordings and the calibration over HTTP", highlight=False)
        with _timed(spent, "upload"):
            site_id = send_site(client, SiteFolder.load(out / "site"), console)
        console.print("4. Fine-tuning without one hand label", highlight=False)
        job = watch(client, client.create_job(site_id, options).id, console, service.check)
        for artifact in _FETCHED:
            client.download_artifact(job.id, artifact.id, out / artifact.file)
        _show(console, out, spent, job)
        console.print(f"\nLook at it in a browser: wibam serve --data {escape(str(out / 'data'))}", highlight=False)
        if keep:
            console.print(f"It is up now, until Ctrl-C: {service.pages_url}", highlight=False, soft_wrap=True)
            with suppress(KeyboardInterrupt):
                service.wait()


def _show(console: Console, out: Path, spent: dict[str, float], job: JobView) -> None:
    """Print what came out, and write it beside."""
    metrics, tracks, conflicts = _read(out, METRICS), _read(out, TRACKS), _read(out, CONFLICTS)
    print_tables(console, metrics, tracks, conflicts)
    paths = {artifact.name: out / artifact.file for artifact in RESULTS}
    spent |= {stage.name: stage.seconds or 0.0 for stage in job.stages}
    warnings = [warning for stage in job.stages for warning in stage.warnings]
    result = summary(metrics, spent, warnings, len(tracks), len(conflicts.conflicts), paths)
    (out / _SUMMARY).write_text(result.model_dump_json(indent=1), encoding="utf-8")
    for name, path in [*paths.items(), ("summary", out / _SUMMARY)]:
        console.print(f"{name:<8} {escape(str(path))}", highlight=False, soft_wrap=True)
    console.print(f"[dim]{sum(spent.values()):.0f} s in all[/]", highlight=False)


#: What a demo takes from the service.
_FETCHED: tuple[Artifact[Any], ...] = (*RESULTS, METRICS, CONFLICTS)
_SUMMARY = "summary.json"
_MARKER = ".wibam-demo"
#: All that a demo writes, beside the marker that says so, and all that the next one removes.
_WRITTEN = ("site", "data", *(artifact.file for artifact in _FETCHED), _SUMMARY)


def _make_room(out: Path) -> None:
    """Make the folder, or remove from it what an earlier demo wrote, and nothing else.

    Raises:
        Conflict: the folder holds something, but no demo; or the demo in it is still running.
    """
    if out.exists() and not out.is_dir():
        raise Conflict(f"{out} is not a folder", hint="Choose another --out.")
    if out.exists() and any(out.iterdir()) and not (out / _MARKER).is_file():
        raise Conflict(f"{out} is not empty, and no demo made it", hint="Choose another --out, or empty it yourself.")
    out.mkdir(parents=True, exist_ok=True)
    (out / _MARKER).write_text("`wibam demo` made this folder, and replaces what it wrote here.\n")
    data = out / "data"
    data.mkdir(mode=0o700, exist_ok=True)
    with exclusive(data):
        for path in [out / name for name in _WRITTEN if name != "data"] + list(data.iterdir()):
            if path.name != LOCK:
                _remove(path)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _record(folder: Path, options: SimulationOptions, console: Console) -> None:
    from wibam_core.synthetic.recorder import record_site  # loading it takes a third of a second

    columns = (*Progress.get_default_columns(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as display:
        task = display.add_task("simulating", total=1.0)

        def show(fraction: float, message: str = "", **_: float) -> None:
            display.update(task, completed=fraction, description=message or "simulating")

        record_site(folder, options, show)


def _read(out: Path, artifact: Artifact[T]) -> T:
    return artifact.codec.read(out / artifact.file)


@contextmanager
def _timed(spent: dict[str, float], name: str) -> Iterator[None]:
    started = time.monotonic()
    yield
    spent[name] = time.monotonic() - started
