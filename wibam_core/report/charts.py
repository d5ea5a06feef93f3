"""Charts: synchronisation, training curves, distributions, metrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from wibam_core.documents.base import MeanSd
from wibam_core.documents.metrics import DetectorFigures, Part, Reliability
from wibam_core.report.style import BASELINE, FINETUNED, GRID, INK, MUTED, camera_colour, new_figure, plain, tidy


@dataclass(frozen=True)
class Delay:
    """A light change in one camera against the same change in the reference camera."""

    camera_id: str
    time_s: float
    before_s: float
    after_s: float


@dataclass(frozen=True)
class Curve:
    """A line over training steps."""

    name: str
    steps: tuple[int, ...]
    values: tuple[float, ...]


@dataclass(frozen=True)
class Histogram:
    """Counts between ``edges`` (one more than counts)."""

    title: str
    unit: str
    edges: tuple[float, ...]
    counts: tuple[int, ...]


@dataclass(frozen=True)
class Bars:
    """Counts by name."""

    title: str
    counts: Mapping[str, int]


def delays_figure(delays: Sequence[Delay], camera_ids: Sequence[str], frame_ms: float | None = None) -> Figure:
    """Delay of every light change to the reference camera, before and after synchronisation.

    Args:
        delays: one per change and camera that shares it with the reference camera.
        camera_ids: of the rig, in order; it fixes the colours.
        frame_ms: one frame interval, drawn as a band around 0 after synchronisation.
    """
    figure = new_figure(8.6, 3.3)
    before, after = figure.subplots(1, 2)
    for number, camera_id in enumerate(camera_ids):
        mine = [delay for delay in delays if delay.camera_id == camera_id]
        if not mine:
            continue
        times = [delay.time_s for delay in mine]
        style = {"color": camera_colour(number), "label": plain(camera_id), "markersize": 5, "mec": "white", "mew": 0.4}
        before.plot(times, [1e3 * delay.before_s for delay in mine], "o", **style)
        after.plot(times, [1e3 * delay.after_s for delay in mine], "o", **style)
    if frame_ms is not None:
        after.axhspan(-frame_ms, frame_ms, color=GRID, alpha=0.55, zorder=0, lw=0)
    tidy(before, title="before", x="time (s)", y="delay to the reference (ms)")
    tidy(after, title="after", x="time (s)", y="delay to the reference (ms)")
    for axes in (before, after):
        axes.axhline(0, color=INK, linewidth=0.8)
    largest = max([abs(1e3 * delay.after_s) for delay in delays] + [frame_ms or 0.0, 1.0])
    after.set_ylim(-1.25 * largest, 1.25 * largest)
    handles, labels = before.get_legend_handles_labels()
    if handles:
        figure.legend(
            handles, labels, loc="outside lower center", ncols=min(len(handles), 8), fontsize=8.5, frameon=False
        )
    return figure


def curves_figure(totals: Sequence[Curve], parts: Sequence[Curve], kept_step: int) -> Figure:
    """Losses over training steps: in all, and by part.

    Args:
        totals: the whole loss, in training and in validation.
        parts: what the training loss is the sum of.
        kept_step: after which the weights that were kept stood.
    """
    figure = new_figure(8.6, 3.3)
    left, right = figure.subplots(1, 2)
    left.axvline(kept_step, color=MUTED, linewidth=0.9, linestyle=":", label="weights kept")
    for number, curve in enumerate(totals):
        _curve(left, curve, (FINETUNED, BASELINE)[number % 2])
    for number, curve in enumerate(parts):
        _curve(right, curve, camera_colour(number))
    tidy(left, title="whole loss", x="step", y="mean of an epoch")
    tidy(right, title="parts of the training loss", x="step")
    for axes in (left, right):
        axes.set_ylim(bottom=0)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=8.5, frameon=False)
    return figure


def _curve(axes: Axes, curve: Curve, colour: str) -> None:
    axes.plot(curve.steps, curve.values, "o-", color=colour, markersize=3.5, label=plain(curve.name))


def distributions_figure(plots: Sequence[Histogram | Bars]) -> Figure:
    """Small bar charts side by side, two in a row."""
    rows = -(-len(plots) // 2)
    figure = new_figure(8.6, 2.3 * rows + 0.2)
    panels = list(figure.subplots(rows, 2, squeeze=False).flat)
    for axes, plot in zip(panels, plots, strict=False):
        if isinstance(plot, Histogram):
            edges = np.array(plot.edges)
            axes.bar(edges[:-1], plot.counts, np.diff(edges), align="edge", color=FINETUNED, edgecolor="white", lw=0.6)
            tidy(axes, title=plot.title, x=plot.unit, y="count")
        else:
            names = [plain(name) for name in plot.counts]
            bars = axes.bar(names, list(plot.counts.values()), 0.65, color=FINETUNED)
            axes.bar_label(bars, fontsize=8, color=INK, padding=1)
            axes.margins(y=0.15)
            tidy(axes, title=plot.title, y="count")
    for unused in panels[len(plots) :]:
        unused.set_visible(False)
    return figure


def before_after_figure(baseline: DetectorFigures, finetuned: DetectorFigures) -> Figure:
    """Mean and standard deviation of the five metrics and recall, baseline beside fine-tuned."""
    figure = new_figure(8.6, 2.5)
    panels = figure.subplots(1, 6)
    shown: tuple[tuple[str, MeanSd, MeanSd, bool], ...] = (
        ("BEV IoU", baseline.bev_iou, finetuned.bev_iou, True),
        ("3D IoU", baseline.iou_3d, finetuned.iou_3d, True),
        ("recall", baseline.recall, finetuned.recall, True),
        ("ATE (m)", baseline.ate_m, finetuned.ate_m, False),
        ("ASE", baseline.ase, finetuned.ase, False),
        ("AOE (°)", baseline.aoe_deg, finetuned.aoe_deg, False),
    )
    for axes, (name, before, after, higher_is_better) in zip(panels, shown, strict=True):
        _pair(axes, before, after, highest=1.0 if higher_is_better else np.inf)
        tidy(axes, title=name, x="higher is better" if higher_is_better else "lower is better")
        axes.xaxis.label.set(color=MUTED, fontsize=8)
        axes.set_xticks((0, 1), [_two_digits(before.mean), _two_digits(after.mean)])
        axes.tick_params(axis="x", labelcolor=INK, length=0)
        axes.set_ylim(0, 1 if higher_is_better else None)
    handles = [panels[0].patches[0], panels[0].patches[1]]
    figure.legend(handles, ["baseline", "fine-tuned"], loc="outside lower center", ncols=2, fontsize=8.5, frameon=False)
    return figure


def _pair(axes: Axes, before: MeanSd, after: MeanSd, highest: float) -> None:
    for at, (value, colour) in enumerate(((before, BASELINE), (after, FINETUNED))):
        mean = value.mean or 0.0
        axes.bar(at, mean, 0.75, color=colour)
        if value.sd is not None:
            spread = [[min(value.sd, mean)], [min(value.sd, highest - mean)]]
            axes.errorbar(at, mean, spread, color=INK, capsize=2, linewidth=0.9)


def _two_digits(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}" if value < 10 else f"{value:.1f}"


def parts_figure(parts: Mapping[str, Mapping[str, Part]], x: str) -> Figure:
    """BEV IoU, ATE and recall by parts of the labelled vehicles, baseline beside fine-tuned.

    Args:
        parts: "baseline" and "finetuned" -> name of a part -> its figures.
        x: what the names are of.
    """
    figure = new_figure(8.6, 2.9)
    panels = figure.subplots(1, 3)
    names = list(dict.fromkeys(name for of in parts.values() for name in of))
    for shift, (network, colour) in enumerate((("baseline", BASELINE), ("finetuned", FINETUNED))):
        of = parts.get(network, {})
        at = np.array([names.index(name) for name in of]) + 0.38 * (shift - 0.5)
        label = "fine-tuned" if network == "finetuned" else network
        panels[0].bar(at, [part.bev_iou.mean or 0.0 for part in of.values()], 0.36, color=colour, label=label)
        panels[1].bar(at, [part.ate_m.mean or 0.0 for part in of.values()], 0.36, color=colour)
        panels[2].bar(at, [part.recall or 0.0 for part in of.values()], 0.36, color=colour)
    for axes, title in zip(panels, ("BEV IoU (matched)", "ATE (m, matched)", "recall"), strict=True):
        tidy(axes, title=title, x=x)
        axes.set_xticks(range(len(names)), names)
        axes.tick_params(axis="x", labelsize=7.5)
    for axes in (panels[0], panels[2]):
        axes.set_ylim(0, 1)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8.5, frameon=False)
    return figure


def interval_name(low: float | None, high: float | None, *, percent: bool = False) -> str:
    """E.g. "10–20", "> 50" or "< 10"."""
    first, second = (None if end is None else f"{end * (100 if percent else 1):g}" for end in (low, high))
    return f"< {second}" if first is None else f"> {first}" if second is None else f"{first}–{second}"


#: Networks of the reliability chart: name in the metrics -> title, colour, dashes.
_STATED = {
    "baseline": ("baseline", BASELINE, "-"),
    "finetuned_as_learned": ("fine-tuned, as learned", FINETUNED, ":"),
    "finetuned": ("fine-tuned, calibrated", FINETUNED, "-"),
}
#: Kinds of numbers that it shows -> title, unit.
_KINDS = {"position": ("position", "m"), "size": ("size", "m"), "yaw": ("heading", "rad")}


def reliability_figure(reliability: Mapping[str, Mapping[str, Reliability]]) -> Figure:
    """How many errors lie in the intervals that should hold a share of them, and errors by stated standard deviation.

    Args:
        reliability: network -> kind of number -> figures.
    """
    figure = new_figure(8.6, 5.4)
    panels = figure.subplots(2, len(_KINDS))
    for column, (kind, (title, unit)) in enumerate(_KINDS.items()):
        above, below = panels[:, column]
        above.plot((0, 100), (0, 100), color=MUTED, linewidth=0.9)
        largest = 0.0
        for network, (name, colour, dashes) in _STATED.items():
            figures = reliability.get(network, {}).get(kind)
            if figures is None or figures.coverage is None:
                continue
            level, held = 100 * np.array(figures.coverage.level), 100 * np.array(figures.coverage.laplace)
            above.plot(level, held, dashes, color=colour, marker="o", markersize=3, label=name)
            stated, made = [one.sd for one in figures.bins], [one.rms for one in figures.bins]
            below.plot(stated, made, dashes, color=colour, marker="o", markersize=3)
            largest = max(largest, *stated, *made)
        below.plot((0, largest), (0, largest), color=MUTED, linewidth=0.9)
        tidy(above, title=title, x="share that should lie within (%)", y="share that does (%)" if not column else "")
        tidy(below, x=f"stated s.d. ({unit})", y="error, r.m.s." if not column else "")
        above.set(xlim=(0, 100), ylim=(0, 100))
        below.set(xlim=(0, None), ylim=(0, None))
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8.5, frameon=False)
    return figure
