"""The rows of the learning benchmark as tables and figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from textwrap import indent
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.learning_limits import limits
from benchmarks.learning_rows import Row, mean_of, versions, width_px_of
from benchmarks.looks import said_of
from wibam_core.config import FinetuneConfig
from wibam_core.evaluation.metrics import METRICS
from wibam_core.report.results import PUBLISHED
from wibam_core.report.style import (
    BASELINE,
    FINETUNED,
    INK,
    MUTED,
    TRUTH,
    camera_colour,
    new_figure,
    tidy,
)

#: Name in a row -> title, digits.
COLUMNS = {
    "bev_iou": ("BEV IoU", 3),
    "iou_3d": ("3D IoU", 3),
    "ate_m": ("ATE m", 3),
    "ase": ("ASE", 3),
    "aoe_deg": ("AOE °", 1),
    "recall": ("recall", 3),
    "precision": ("precision", 3),
    "false_positives": ("false positives", 0),
    "bev_iou_misses_zero": ("BEV IoU, misses as 0", 3),
}
_COLOURS = {
    "baseline_depth": MUTED,
    "baseline_plane": camera_colour(4),
    "baseline": BASELINE,
    "paper": camera_colour(3),
    "lifted": FINETUNED,
    "truth": TRUTH,
    "labels": INK,
}
_OTHER = camera_colour(5)
_SIGNIFICANT = 0.01


def document(rows: Sequence[Row], command: str, name: str = "learning") -> str:
    """Markdown: the command (one or more lines), what was chosen on, and all tables; figures are those of `draw`."""
    sites = sorted({row["run"]["site"] for row in rows})
    seconds = " or ".join(f"{one:g}" for one in sorted({row["run"]["seconds"] for row in rows}))
    widths = " or ".join(map(str, sorted({width_px_of(row["run"]) for row in rows})))
    about = (
        f"Sites: {', '.join(map(str, sites))}; {seconds} s each, {widths} px wide. Means of the runs ± their standard "
        "deviation."
    )
    parts = [
        "# What fine-tuning gains",
        f"{about} {caveats(rows)}",
        "Before reading on:",
        limits(rows),
        indent(command, "    "),
        table(rows),
        *_titled(
            "As the published evaluation counts (`paper_compat`), beside what the paper reports of its own test set.",
            as_published(rows),
        ),
        *_titled("How a job is asked for a method, where it is not what it does unless asked.", options(rows)),
        *_titled(
            "BEV IoU against the baseline: runs in which it differs significantly (p < 0.01, bootstrap over vehicles).",
            verdicts(rows),
        ),
        *_titled(
            "Relative to the same training on true boxes, run by run. Share of the gain: (method − baseline) / "
            "(truth − baseline) in BEV IoU with misses as 0.",
            ratios(rows),
        ),
        *_titled("By distance from the camera: BEV IoU of the matched / recall.", by_distance(rows)),
        f"![metrics]({name}.png)",
        f"![by distance]({name}-distance.png)",
    ]
    return "\n\n".join(parts) + "\n"


def caveats(rows: Sequence[Row]) -> str:
    """What whoever reads these rows should know: which sites were chosen on or seen, and whether the code changed."""
    sites = sorted({row["run"]["site"] for row in rows})
    return " ".join(filter(None, (said_of(sites), versions(rows))))


def methods_of(rows: Sequence[Row]) -> list[str]:
    """In the order of the rows."""
    return list(dict.fromkeys(row["run"]["method"] for row in rows))


def table(rows: Sequence[Row]) -> str:
    """Means over sites and seeds, and the standard deviation of those means."""
    lines = _head("method", "decode", "runs", *(title for title, _ in COLUMNS.values()))
    for method in methods_of(rows):
        mine = [row for row in rows if row["run"]["method"] == method]
        cells = [_cell([mean_of(row, name) for row in mine], digits) for name, (_, digits) in COLUMNS.items()]
        lines.append(_line(method, mine[0]["decode"], len(mine), *cells))
    return "\n".join(lines)


def as_published(rows: Sequence[Row]) -> str:
    """The same means as `table`, counted as the published evaluation counts; empty where no row was counted so."""
    lines = _head("method", "runs", *(COLUMNS[name][0] for name in METRICS))
    for method in methods_of(rows):
        mine = [row["paper_compat"] for row in rows if row["run"]["method"] == method and row.get("paper_compat")]
        if mine:
            cells = [_cell([mean_of(row, name) for row in mine], COLUMNS[name][1]) for name in METRICS]
            lines.append(_line(method, len(mine), *cells))
    if len(lines) == 2:
        return ""
    for title, at in (("the paper, before", 0), ("the paper, after", 1)):
        reported = [PUBLISHED[name][at].mean for name in METRICS]
        lines.append(_line(title, "–", *(_cell([value], 2) for value in reported)))
    return "\n".join(lines)


def options(rows: Sequence[Row]) -> str:
    """Method -> how a job is asked for it; empty where all is as a job does it unless asked."""
    usual = FinetuneConfig().model_dump()
    lines = _head("method", "options of `wibam run`")
    for method in methods_of(rows):
        run = next(row["run"] for row in rows if row["run"]["method"] == method)
        asked = {name: value for name, value in (run.get("finetune") or {}).items() if usual.get(name) != value}
        asked = {f"finetune.{name}": value for name, value in asked.items() if name not in ("seed", "steps")}
        asked |= {f"lift.{name}": value for name, value in run.get("lift", {}).items()}
        if asked:
            typed = (
                f"--set {name}={value if isinstance(value, str) else json.dumps(value)}"
                for name, value in asked.items()
            )
            lines.append(_line(method, f"`{' '.join(typed)}`"))
    return "\n".join(lines) if len(lines) > 2 else ""


def verdicts(rows: Sequence[Row]) -> str:
    """How often each method is better or worse than the baseline by more than chance; empty without other methods."""
    lines = _head("method", "runs", "better", "worse", "chance")
    for method in methods_of(rows):
        tests = [
            row["significance"]["bev_iou"]
            for row in rows
            if row["run"]["method"] == method and method != "baseline" and row.get("significance")
        ]
        if tests:
            real = [t["difference"] for t in tests if t["p_bootstrap"] is not None and t["p_bootstrap"] < _SIGNIFICANT]
            better = sum(difference > 0 for difference in real)
            lines.append(_line(method, len(tests), better, len(real) - better, len(tests) - len(real)))
    return "\n".join(lines) if len(lines) > 2 else ""


def ratios(rows: Sequence[Row]) -> str:
    """Figures relative to those of ``truth`` at the same site and seed; empty without."""
    truth = {_place(row): row for row in rows if row["run"]["method"] == "truth"}
    baseline = {_place(row): row for row in rows if row["run"]["method"] == "baseline"}
    shown = ("bev_iou", "iou_3d", "ate_m", "bev_iou_misses_zero")
    lines = _head("method", *(f"{COLUMNS[name][0]} / truth's" for name in shown), "share of the gain")
    for method in methods_of(rows):
        mine = [row for row in rows if row["run"]["method"] == method and _place(row) in truth]
        if not mine or method == "truth":
            continue
        cells = [_cell([_ratio(row, truth[_place(row)], name) for row in mine], 2) for name in shown]
        gains = [
            share_of_gain(row, baseline[_place(row)], truth[_place(row)]) for row in mine if _place(row) in baseline
        ]
        lines.append(_line(method, *cells, _cell(gains, 2)))
    return "\n".join(lines) if len(lines) > 2 else ""


def share_of_gain(row: Row, start: Row, goal: Row, name: str = "bev_iou_misses_zero") -> float | None:
    """How far a figure got on the way from ``start`` to ``goal``; None where there is no way to go."""
    here, first, last = (mean_of(one, name) for one in (row, start, goal))
    if here is None or first is None or last is None or last == first:
        return None
    return (here - first) / (last - first)


def by_distance(rows: Sequence[Row]) -> str:
    """BEV IoU and recall by distance; empty where no row has parts."""
    edges = _distance_edges(rows)
    lines = _head("method", *(f"{low:g}–{high:g} m" for low, high in edges))
    for method in methods_of(rows):
        cells = [
            f"{_cell(_of_bin(rows, method, edge, 'bev_iou'), 2)} / {_cell(_of_bin(rows, method, edge, 'recall'), 2)}"
            for edge in edges
        ]
        if any(cell != "– / –" for cell in cells):
            lines.append(_line(method, *cells))
    return "\n".join(lines) if len(lines) > 2 else ""


def draw(rows: Sequence[Row], folder: Path, name: str = "learning") -> None:
    """Write ``name.png`` and ``name-distance.png``."""
    save(metrics_figure(rows), folder / f"{name}.png")
    save(distance_figure(rows), folder / f"{name}-distance.png")


def save(figure: Figure, path: Path) -> None:
    """As PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def metrics_figure(rows: Sequence[Row]) -> Figure:
    """Bars of the methods in each metric: as counted correctly, and below as the published evaluation counts, with what
    the paper reports before and after as lines; without the lower part where no row was counted so."""
    methods = methods_of(rows)
    counted = {"correct": list(rows)}
    if compat := [{"run": row["run"], **row["paper_compat"]} for row in rows if row.get("paper_compat")]:
        counted["paper_compat"] = compat
    figure = new_figure(11.0, 1.2 + (0.5 + 0.3 * len(methods)) * len(counted))
    panels = figure.subplots(len(counted), len(METRICS), sharey=True, squeeze=False)
    for of, (way, own) in zip(panels, counted.items(), strict=True):
        for axes, name in zip(of, METRICS, strict=True):
            _bars(axes, methods, own, name)
            if way == "paper_compat":
                before, after = PUBLISHED[name]
                _level(axes, before.mean, ":", "the paper, before (its own set)")
                _level(axes, after.mean, "--", "the paper, after (its own set)")
            better = "higher" if name in ("bev_iou", "iou_3d") else "lower"
            tidy(axes, title=f"{COLUMNS[name][0]}, {way}", x=f"{better} is better", grid="x")
        of[0].set_yticks(range(len(methods)), methods)
    panels[0][0].invert_yaxis()
    handles, labels = panels[-1][0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8.5, frameon=False)
    return figure


def _bars(axes: Axes, methods: Sequence[str], rows: Sequence[Row], name: str) -> None:
    for at, method in enumerate(methods):
        values = _known([mean_of(row, name) for row in rows if row["run"]["method"] == method])
        if values:
            spread = np.std(values, ddof=1) if len(values) > 1 else None
            error = {"ecolor": INK, "capsize": 2}
            axes.barh(at, np.mean(values), 0.8, xerr=spread, color=colour_of(method), error_kw=error)


def distance_figure(rows: Sequence[Row]) -> Figure:
    """BEV IoU, ATE and recall by distance from the camera, of the methods that have a colour of their own."""
    figure = new_figure(11.0, 3.4)
    edges = _distance_edges(rows)
    places = [(low + high) / 2 for low, high in edges]
    for axes, (name, title) in zip(
        figure.subplots(1, 3),
        (("bev_iou", "BEV IoU (matched)"), ("ate_m", "ATE (m, matched)"), ("recall", "recall")),
        strict=True,
    ):
        for method in filter(_COLOURS.__contains__, methods_of(rows)):
            means = [_known(_of_bin(rows, method, edge, name)) for edge in edges]
            known = [(place, np.mean(values)) for place, values in zip(places, means, strict=True) if values]
            if known:
                axes.plot(*zip(*known, strict=True), "o-", color=colour_of(method), markersize=4, label=method)
        tidy(axes, title=title, x="distance (m)")
        axes.set_ylim(0, None if name == "ate_m" else 1)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=8.5, frameon=False)
    return figure


def colour_of(method: str) -> str:
    """The same in every figure: its own of the usual methods, one for all others."""
    return _COLOURS.get(method, _OTHER)


def _titled(title: str, rows: str) -> tuple[str, ...]:
    return (title, rows) if rows else ()


def _level(axes: Axes, value: float | None, dashes: str, label: str) -> None:
    if value is not None:
        axes.axvline(value, color=MUTED, linestyle=dashes, linewidth=1.2, label=label)


def _place(row: Row) -> tuple[Any, Any]:
    return row["run"]["site"], row["run"]["seed"]


def _ratio(row: Row, other: Row, name: str) -> float | None:
    mine, theirs = mean_of(row, name), mean_of(other, name)
    return mine / theirs if mine is not None and theirs else None


def _distance_edges(rows: Sequence[Row]) -> list[tuple[float, float]]:
    parts = [part for row in rows for part in row.get("by_distance", ()) if part["high"] is not None]
    return sorted({(part["low"], part["high"]) for part in parts})


def _of_bin(rows: Sequence[Row], method: str, edge: tuple[float, float], name: str) -> list[float | None]:
    return [
        mean_of(part, name)
        for row in rows
        if row["run"]["method"] == method
        for part in row.get("by_distance", ())
        if (part["low"], part["high"]) == edge
    ]


def _known(values: Sequence[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _cell(values: Sequence[float | None], digits: int) -> str:
    known = _known(values)
    if not known:
        return "–"
    spread = f" ± {np.std(known, ddof=1):.{digits}f}" if len(known) > 1 else ""
    return f"{np.mean(known):.{digits}f}{spread}"


def _head(*titles: str) -> list[str]:
    return [_line(*titles), "|" + "---|" * len(titles)]


def _line(*cells: object) -> str:
    return f"| {' | '.join(map(str, cells))} |"
