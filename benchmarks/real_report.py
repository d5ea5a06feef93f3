"""Rows of the benchmark of real sites as a document and a drawing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from benchmarks.looks import said_of
from benchmarks.real_labels import MATCH_M, Area, Labels
from benchmarks.real_measures import ONE_CAMERA_M, tracks_at
from wibam_core.report.bev import draw_footprints
from wibam_core.report.style import FINETUNED, GRID, MUTED, TRUTH, new_figure, tidy
from wibam_core.scene import CameraRig, Track

Row = Mapping[str, Any]

_SUBSETS = ("all", "train", "val", "test", "gap")


def birds_eye(labels: Sequence[Labels], area: Area, tracks: Sequence[Track], rig: CameraRig) -> Figure:
    """Labels and tracks from above, a panel a labelled instant; the labelled area is outlined."""
    columns = min(4, len(labels))
    rows = -(-len(labels) // columns)
    figure = new_figure(2.9 * columns, 3.0 * rows + 0.5, fixed_aspect=True)
    panels = list(figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).flat)
    low, high = area.corners.min(axis=0) - 8.0, area.corners.max(axis=0) + 8.0
    for axes, one in zip(panels, labels, strict=False):
        tidy(axes, title=f"t = {one.time_ns * 1e-9:.1f} s", x="x (m)", y="y (m)", grid="both")
        axes.add_patch(Polygon(area.corners, closed=True, fill=False, edgecolor=MUTED, lw=1.0, ls=(0, (4, 3))))
        for camera in rig.values():
            axes.plot(*camera.centre_m[:2], "o", color=MUTED, markersize=4)
        draw_footprints(axes, one.boxes, TRUTH, filled=True)
        for x, y, length, width, yaw in one.ignored:
            draw_footprints(axes, np.array([[x, y, 1.0, length, width, 2.0, yaw]]), GRID, filled=True)
        draw_footprints(axes, tracks_at(tracks, one.time_ns), FINETUNED)
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_aspect("equal")
    for unused in panels[len(labels) :]:
        unused.set_visible(False)
    handles = [
        Line2D([], [], color=TRUTH, lw=6, alpha=0.35, label="labelled by hand"),
        Line2D([], [], color=GRID, lw=6, label="counts neither way"),
        Line2D([], [], color=FINETUNED, lw=1.5, label="tracks"),
        Line2D([], [], color=MUTED, lw=1.0, ls=(0, (4, 3)), label="labelled area"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8.5, frameon=False)
    return figure


def save(figure: Figure, path: Path) -> None:
    """As PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def tables(rows: Sequence[Row]) -> str:
    """Markdown: all tables of the rows."""
    taught = [row for row in rows if "tracks" in row]
    parts = [
        "## Tracks of all cameras",
        _table(_NAMES, [(*_run(row), *_figures(row["tracks"]["all"])) for row in taught]),
        "By the part of the split in time that the labelled instant lies in. The network learned from the training "
        "part; instants between two parts are in none.",
        _table(
            ("part", *_NAMES),
            [
                (part, *_run(row), *_figures(row["tracks"][part]))
                for row in taught
                for part in _SUBSETS[1:]
                if part in row["tracks"]
            ],
        ),
        "Without the shift that all vehicles share: the mean over the same vehicles, which flatters a little. Cameras "
        "cannot tell it from the traffic, and labels are no surer of it than their own frame is.",
        _table(
            ("of", *_NAMES[:5], "shift x, y (m)", "ATE m", "without", "BEV IoU", "without"),
            [
                (of, *_run(row), *_unshifted(row[of]["all"]))
                for row in rows
                for of in ("tracks", "fits")
                if of in row and row[of]["all"].get("shift_m")
            ],
        ),
        "## The fits that teach",
        "A vehicle that a later part of the split sees, too, teaches nothing in the earlier one. The last column asks "
        "for the vehicles alone that may teach where the label is.",
        _table(
            (*_NAMES, "of the training part", "of those that may teach"),
            [
                (
                    *(*_run(row), *_figures(row["fits"]["all"])),
                    *(_counts(row["fits"].get("train")), _counts(row.get("may_teach"))),
                )
                for row in rows
            ],
        ),
        f"## One camera, vehicles within {ONE_CAMERA_M:g} m of it",
        _table(
            ("camera", *_NAMES),
            [(camera, *_run(row), *_figures(of)) for row in taught for camera, of in row["one_camera"].items()],
        ),
        "## What each round found",
        _table(
            _ROUND_NAMES,
            [line for row in rows for line in _rounds(row)],
        ),
    ]
    return "\n\n".join(parts)


_NAMES = (
    *("version", "detector", "rounds", "steps", "seed", "found", "further", "recall (95 %)", "precision (95 %)"),
    *("ATE m (median)", "AOE °", "BEV IoU (95 %)"),
)
_ROUND_NAMES = (
    *("detector", "seed", "round", "boxes an image", "vehicles an instant seen by 1 / 2 / 3 / 4", "held out: found"),
    *("IoU where found", "IoU summed, an instant", "vehicles that taught", "kept"),
)


def _run(row: Row) -> tuple[str, ...]:
    return row.get("version", "0.4.0"), row["detector"], str(row["round"]), str(row["steps"]), str(row["seed"])


def _figures(of: Row) -> tuple[str, ...]:
    def ranged(name: str) -> str:
        ends = of[f"{name}_interval"]
        return _number(of[name]) + ("" if ends is None else f" ({_number(ends[0])}–{_number(ends[1])})")

    return (
        f"{of['found']} of {of['asked']}",
        str(of["false"]),
        ranged("recall"),
        ranged("precision"),
        f"{_number(of['ate_m'])} ({_number(of['ate_m_median'])})",
        _number(of["aoe_deg"], 1),
        ranged("bev_iou"),
    )


def _unshifted(of: Row) -> tuple[str, ...]:
    x, y = of["shift_m"]
    return (
        f"{x:+.2f}, {y:+.2f}",
        _number(of["ate_m"]),
        _number(of["ate_m_unshifted"]),
        _number(of["bev_iou"]),
        _number(of["bev_iou_unshifted"]),
    )


def _counts(of: Row | None) -> str:
    return "–" if of is None else f"{of['found']} of {of['asked']}"


def _rounds(row: Row) -> list[tuple[str, ...]]:
    rounds = row["rounds"]
    lines = []
    for one in rounds["rounds"]:
        agreement = one["agreement"]
        lines.append(
            (
                row["detector"],
                str(row["seed"]),
                str(one["number"]),
                ", ".join(f"{of:.1f}" for of in one["boxes_an_image"].values()),
                " / ".join(f"{one['vehicles_an_instant'].get(str(n), 0):.2f}" for n in (1, 2, 3, 4)),
                _number(agreement["found"]),
                _number(agreement["iou"]),
                _number(agreement["an_instant"]),
                "–" if one["taught_vehicles"] is None else str(one["taught_vehicles"]),
                "yes" if one["number"] == rounds["kept"] else "",
            )
        )
    return lines


def _number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _table(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    return "\n".join(
        [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads), *(f"| {' | '.join(of)} |" for of in lines)]
    )


_ABOUT = """\
# Real sites, against hand labels

A vehicle is found if a box lies within {match:g} m of it. Every vehicle in the labelled area was labelled: a further
box is one in that area that is no labelled vehicle. Boxes close to its border and on trailers count neither way. Shares
have Wilson's 95 % interval; means have one of bootstrap samples of vehicles. Labels evaluate: how
many rounds are kept follows from the agreement between views, at instants that taught nothing and are not tested.

Site: {sites}. It is one site and one minute, with few labelled instants, whose labels err by about 0.1 m at random, by
0.2 m together, and by 3°. {looks} Options of all rows: `{options}`; those of each are in `real-sites.json`, and
`python -m benchmarks.real_sites --help` says how to measure.

{notes}{tables}

![labels and tracks from above](real-sites.png)
"""


def document(rows: Sequence[Row]) -> str:
    """Markdown: what was measured, and all tables."""
    options = " ".join(min((row["options"] for row in rows), key=len))
    names = sorted({row["site"] for row in rows})
    notes = "".join(f"{note}\n\n" for note in dict.fromkeys(row["note"] for row in rows if "note" in row))
    return _ABOUT.format(
        match=MATCH_M, sites=", ".join(names), looks=said_of(names), options=options, notes=notes, tables=tables(rows)
    )
