"""Live progress in a terminal: one line per stage, shared by `wibam run`, `wibam jobs watch` and `wibam demo`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from wibam_core.documents.warnings import StageWarning
from wibam_core.stages.graph import STAGES

_UNLIMITED = 10_000  # columns
_NAMED = 5
_MARKS = {
    "pending": "[dim]·[/]",
    "running": "[cyan]▶[/]",
    "succeeded": "[green]✓[/]",
    "given": "[green]◆[/]",
    "reused": "[green]↺[/]",
    "failed": "[red]✗[/]",
    "cancelled": "[yellow]■[/]",
}


def list_table(*ids: str, others: Sequence[str]) -> Table:
    """A table without lines, for `print_list`: columns of ids, which are never broken, then others."""
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    for title in ids:
        table.add_column(title, no_wrap=True)
    for title in others:
        table.add_column(title)
    return table


def print_list(console: Console, table: Table) -> None:
    """Print a table with its ids whole, however narrow the terminal is; in a pipe or a file each row is one line."""
    needed = Measurement.get(console, console.options.update(width=_UNLIMITED), table)
    width = needed.minimum if console.is_terminal else needed.maximum
    if width > console.width or not console.is_terminal:
        table.width = width
    console.print(table, crop=False, soft_wrap=False)


def print_rows(ids: Sequence[str], others: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a list: the titles of its columns of ids, those of the others, and its rows of plain text."""
    table = list_table(*ids, others=others)
    for row in rows:
        table.add_row(*map(escape, row))
    print_list(Console(), table)


def to_minute(time: str | None, without: str = "") -> str:
    """A time of the service as lists show it (UTC); ``without`` where there is none."""
    return without if time is None else time[:16].replace("T", " ")


def print_warning(console: Console, warning: StageWarning) -> None:
    """Print what is doubtful, and what to do about it."""
    console.print(f"[yellow]warning[/] {escape(warning.message)}", highlight=False)
    console.print(f"        [dim]{escape(warning.hint)}[/]", highlight=False)


def print_unclaimed(console: Console, names: Sequence[str]) -> None:
    """Say which files beside the recordings are no camera's, and so are not used."""
    if names:
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        console.print(
            f"[yellow]warning[/] recordings/{escape(', '.join(names[:_NAMED]))}{more}: not used, since no camera of "
            "site.json is called so",
            highlight=False,
        )


def print_overlap(console: Console, calibrated: Path | None) -> None:
    """Print how much of the road each pair of cameras sees together: known within seconds, before hours are spent.

    Args:
        console: where to.
        calibrated: the outputs of the stage `calibrate`.
    """
    from wibam_core.artifacts.access import ArtifactReader
    from wibam_core.artifacts.catalogue import RESIDUALS  # takes a tenth of a second, which other commands do not need

    if calibrated is None:
        return
    overlap = ArtifactReader({RESIDUALS.stage: calibrated}).read(RESIDUALS).overlap
    if overlap is None or not overlap.pairs:
        return
    within = f"within {overlap.within_m:.0f} m of the middle of all"
    for pair in overlap.pairs:
        shared = f"{pair.area_m2:.0f} m² ({pair.share:.0%} of what the one that sees less sees)"
        text = f"{' and '.join(pair.cameras)} share {shared if pair.area_m2 else 'no road'}"
        console.print(f"        {escape(text)} {within}", highlight=False, soft_wrap=True)


@dataclass
class _Line:
    task: TaskID
    state: str = "pending"


def time_left(seconds: float) -> str:
    """About so long, in a few letters: "40 s", "3 min", "2.5 h"."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


class StageDisplay:
    """A context manager that shows how the stages of one job are doing.

    In a terminal the lines are live; elsewhere (a pipe, a log) one line is printed when a stage ends.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._progress = Progress(
            TextColumn("{task.fields[mark]} {task.description:<36}"),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f}%"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
            TextColumn("[dim]{task.fields[message]}[/]"),
            console=console,
            disable=not console.is_terminal,
        )
        self._lines: dict[str, _Line] = {}
        self._whole: TaskID | None = None

    def __enter__(self) -> StageDisplay:
        self._progress.start()
        for name, spec in STAGES.items():
            task = self._progress.add_task(
                spec.title, total=1.0, start=False, mark=_MARKS["pending"], message="", left=""
            )
            self._lines[name] = _Line(task)
        self._whole = self._progress.add_task("In all", total=1.0, start=True, mark=" ", message="", left="")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def update(
        self,
        stage: str,
        state: str,
        fraction: float = 0.0,
        message: str = "",
        figures: Mapping[str, Any] | None = None,
        seconds: float | None = None,
        warnings: Sequence[StageWarning] = (),
        remaining_s: float | None = None,
        job_remaining_s: float | None = None,
    ) -> None:
        """Show a stage's state ("pending", "running", "given", "succeeded", "reused", ...).

        Its warnings are printed above the lines, once, when it ends. What is known of how long the stage, and all of
        them, will still take (s) stands beside.
        """
        line = self._lines[stage]
        if state == "running" and line.state != "running":
            self._progress.start_task(line.task)
        shown = "  ".join([message, *(f"{k} {v:.3g}" for k, v in (figures or {}).items())]).strip()
        ended = state in ("given", "succeeded", "reused", "failed", "cancelled")
        self._progress.update(
            line.task,
            completed=1.0 if state in ("given", "succeeded", "reused") else fraction,
            mark=_MARKS.get(state, " "),
            message=shown,
            left="" if ended or remaining_s is None else f"{time_left(remaining_s)} left",
        )
        if self._whole is not None and job_remaining_s is not None:
            spent_s = self._progress.tasks[self._whole].elapsed or 0.0
            self._progress.update(
                self._whole,
                completed=spent_s / max(spent_s + job_remaining_s, 1e-9),
                left=f"{time_left(job_remaining_s)} left",
            )
        if ended and line.state != state:
            self._progress.stop_task(line.task)
            if not self._console.is_terminal:
                took = "" if seconds is None else f"{seconds:6.1f} s"
                self._console.print(f"{state:>9} {took:>9}  {STAGES[stage].title}", highlight=False)
            for warning in warnings:
                print_warning(self._console, warning)
        line.state = state
