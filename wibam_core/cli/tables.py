"""Results in a terminal: the before/after table, the first tracks and the first conflicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.artifacts.artifact import Artifact
from wibam_core.documents.base import MeanSd
from wibam_core.documents.conflicts import ConflictRow, Conflicts
from wibam_core.documents.metrics import DetectorFigures, Metrics, Significance
from wibam_core.documents.rounds import Rounds
from wibam_core.geometry.box3d import SIZE, XY
from wibam_core.report.advice import test_part
from wibam_core.report.results import NETWORKS, compared
from wibam_core.report.rounds import ROUND_TITLES, round_rows
from wibam_core.scene import Track

_COLUMNS = (
    ("bev_iou", "BEV IoU", 2),
    ("iou_3d", "3D IoU", 2),
    ("ate_m", "ATE m", 2),
    ("ase", "ASE", 3),
    ("aoe_deg", "AOE °", 1),
    ("recall", "recall", 2),
)
_SIGNIFICANT = 0.01


def print_results(console: Console, outputs: ArtifactReader) -> None:
    """Print what a finished pipeline found and where its files lie.

    Args:
        console: where to.
        outputs: of all its stages.
    """
    tracks = outputs.read(catalogue.TRACKS)
    rounds = rounds_table(outputs.read(catalogue.ROUNDS))
    if rounds is not None:
        console.print(rounds)
    print_tables(console, outputs.read(catalogue.METRICS), tracks, outputs.read(catalogue.CONFLICTS))
    for name, path in result_paths(outputs).items():
        console.print(f"{name:<8} {escape(str(path))}", highlight=False, soft_wrap=True)


#: The files that a person wants.
RESULTS: tuple[Artifact[Any], ...] = (catalogue.WEIGHTS, catalogue.TRACKS, catalogue.REPORT)


def result_paths(outputs: ArtifactReader) -> dict[str, Path]:
    """Where the files lie that a person wants, by the names of `RESULTS`."""
    return {artifact.name: outputs.local(artifact) for artifact in RESULTS}


def print_tables(console: Console, metrics: Metrics, tracks: Sequence[Track], conflicts: Conflicts) -> None:
    """Print the before/after table by both evaluators, the first tracks and the first conflicts.

    Args:
        console: where to.
        metrics: of both networks.
        tracks: all of them.
        conflicts: all of them.
    """
    console.print(before_after_table(metrics))
    published = published_table(metrics)
    if published is not None:
        console.print(published)
    console.print(tracks_table(tracks))
    console.print(conflicts_table(conflicts.conflicts))


def rounds_table(rounds: Rounds) -> Table | None:
    """What each round found; None without rounds."""
    rows = round_rows(rounds)
    if not rows:
        return None
    table = Table(title="Rounds of finding and teaching", title_justify="left", caption=rounds.reason)
    table.add_column("round")
    for title in ROUND_TITLES:
        table.add_column(title, justify="right")
    for row in rows:
        table.add_row(*row)
    return table


def before_after_table(metrics: Metrics) -> Table:
    """Baseline against fine-tuned; without labels, their agreement between views."""
    if metrics.finetuned is None:
        return _consistency_table(metrics)
    detectors = {name: getattr(metrics, name) for name in compared(metrics)}
    table = _figures_table("Before and after, on held-out time", detectors, _COLUMNS, metrics.significance or {})
    table.caption = _caption(metrics)
    for title, count in (("matched", "matched"), ("missed", "missed"), ("false positives", "false_positives")):
        table.add_row(title, *(_count(getattr(figures, count)) for figures in detectors.values()))
    table.add_row("BEV IoU, misses as 0", *(_cell(figures.bev_iou_misses_zero, 2) for figures in detectors.values()))
    return table


def published_table(metrics: Metrics) -> Table | None:
    """The same detectors measured with the quirks of the published evaluation; None without labels."""
    if metrics.paper_compat is None:
        return None
    detectors = {name: metrics.paper_compat[name] for name in NETWORKS if name in metrics.paper_compat}
    table = _figures_table("As the published evaluation would count (paper_compat)", detectors, _COLUMNS[:-1], {})
    table.caption = "only boxes that overlap in the image, misses not counted, headings off by 150° and more left out"
    table.add_row("matched", *(_count(figures.matched) for figures in detectors.values()))
    return table


def _figures_table(
    title: str,
    detectors: Mapping[str, DetectorFigures],
    columns: Sequence[tuple[str, str, int]],
    tests: Mapping[str, Significance],
) -> Table:
    """One row a metric, one column a detector; the fine-tuned one carries the marks of significance."""
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for name in detectors:
        table.add_column(NETWORKS[name], justify="right", style="bold" if name == "finetuned" else "")
    for key, metric, digits in columns:
        marks = [tests.get(key) if name == "finetuned" else None for name in detectors]
        figures = detectors.values()
        table.add_row(metric, *(_cell(getattr(f, key), digits, mark) for f, mark in zip(figures, marks, strict=True)))
    table.add_row("AOE of 150° and more", *(_share(figures.alias_share) for figures in detectors.values()))
    return table


def tracks_table(tracks: Sequence[Track], first: int = 5) -> Table:
    """The first tracks by time."""
    ordered = sorted(tracks, key=lambda track: (int(track.times_ns[0]), track.track_id))[:first]
    table = Table(title=f"Tracks: {len(ordered)} of {len(tracks)}", title_justify="left")
    for title in ("track", "class", "from s", "for s", "states", "path m", "mean km/h", "l × w × h m"):
        table.add_column(title, justify="left" if title == "class" else "right")
    for track in ordered:
        seconds = (track.times_ns - track.times_ns[0]) / 1e9
        path = float(np.linalg.norm(np.diff(track.boxes[:, XY], axis=0), axis=1).sum())
        speed = float(np.linalg.norm(track.velocities_mps, axis=1).mean()) * 3.6
        length, width, height = np.median(track.boxes[:, SIZE], axis=0)
        table.add_row(
            str(track.track_id),
            track.vehicle_class.value,
            f"{track.times_ns[0] / 1e9:.1f}",
            f"{seconds[-1]:.1f}",
            str(len(track)),
            f"{path:.1f}",
            f"{speed:.0f}",
            f"{length:.1f} × {width:.1f} × {height:.1f}",
        )
    return table


def conflicts_table(conflicts: Sequence[ConflictRow], first: int = 5) -> Table:
    """The first conflicts by time, with the 90 % intervals."""
    shown = conflicts[:first]
    table = Table(title=f"Conflicts: {len(shown)} of {len(conflicts)}", title_justify="left")
    for title in ("time s", "type", "tracks", "classes", "TTC s", "PET s", "km/h"):
        table.add_column(title, justify="right" if title in ("time s", "TTC s", "PET s", "km/h") else "left")
    for row in shown:
        table.add_row(
            f"{row.time_ns / 1e9:.1f}",
            escape(row.type.replace("_", " ")),
            " – ".join(map(str, row.track_ids)),
            escape(" – ".join(row.classes)),
            _timed(row.ttc_s, row.ttc_interval_s),
            _timed(row.pet_s, row.pet_interval_s),
            " – ".join(f"{3.6 * speed:.0f}" for speed in row.speeds_mps),
        )
    return table


def _consistency_table(metrics: Metrics) -> Table:
    table = Table(
        title="Before and after, on held-out time",
        title_justify="left",
        caption=f"No labels in the test part ({test_part(metrics)}): agreement between views, which says nothing about "
        "an error that all views share.",
    )
    for title in ("", "found", "IoU in the other views", "IoU in its own view", "pairs"):
        table.add_column(title, justify="left" if not title else "right")
    for name, title in NETWORKS.items():
        if name in metrics.self_consistency:
            value = metrics.self_consistency[name]
            found = "–" if value.found is None else f"{value.found:.2f}"
            agreement = (_cell(value.other_views, 2), _cell(value.own_view, 2), str(value.pairs))
            table.add_row(title, found, *agreement)
    return table


def _caption(metrics: Metrics) -> str:
    of = f"mean (s.d.) over matched vehicles in {metrics.frames} images; "
    tests = (metrics.significance or {}).values()
    if any(test.is_of_too_few for test in tests):
        return of + "too few different vehicles to say what differs by more than chance"
    return of + f"** differs from the baseline at p < {_SIGNIFICANT} (bootstrap over vehicles), * at p < 0.05"


def _cell(value: MeanSd, digits: int, test: Significance | None = None) -> str:
    if value.mean is None:
        return "–"
    spread = "" if value.sd is None else f" ({value.sd:.{digits}f})"
    return f"{value.mean:.{digits}f}{spread}{significance_mark(test)}"


def significance_mark(test: Significance | None) -> str:
    """Stars for the bootstrap's p: ``**`` below 0.01, ``*`` below 0.05."""
    if test is None or test.p_bootstrap is None:
        return ""
    return "**" if test.p_bootstrap < _SIGNIFICANT else "*" if test.p_bootstrap < 0.05 else ""


def _count(value: int | None) -> str:
    return "–" if value is None else str(value)


def _share(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"


def _timed(value: float | None, interval: tuple[float | None, float | None]) -> str:
    if value is None:
        return "–"
    low, high = ("∞" if end is None else f"{end:.1f}" for end in interval)
    return f"{value:.1f} ({low}–{high})"
