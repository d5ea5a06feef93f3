"""How well measures that need no label tell the true error.

Networks of varied quality (before fine-tuning, after few and many steps, taught by few frames, by the published loss)
on several sites. For each, and for each vehicle of the test part, what self-consistency says is compared with the
truth: the image IoU of boxes in the views that they were not predicted in, and their roughness (how far they lie beside
the straight line between the boxes before and after), against BEV IoU and ATE. Prints the correlations.
Writes ``self-consistency.json`` (a killed run goes on where it was), ``self-consistency.md`` and ``.png``. Networks
that ``benchmarks.learning`` measured can be compared, too.

Run: python -m benchmarks.self_consistency --sites 11 12 21 22 --seconds 90 --out docs [--with docs/ablation.json]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from benchmarks.learning_options import command_of, made_rows, recording_of, site_parser
from benchmarks.learning_report import caveats, save
from benchmarks.learning_rows import Row, Run, joined, mean_of
from benchmarks.learning_sites import (
    OF_VEHICLE,
    Figures,
    Site,
    Trained,
    figures,
    finetuned_by_stage,
    finetuned_on,
    untrained,
    views,
)
from benchmarks.looks import chosen_on
from wibam_core.config import FinetuneConfig
from wibam_core.placing import Decode
from wibam_core.report.style import camera_colour, new_figure, tidy

#: What needs no label -> title.
MEASURES = {"other_views": "IoU in other views", "roughness_m": "roughness (m)"}
#: The truth of a network -> title; that of a vehicle is `OF_VEHICLE`.
TRUTHS = {"bev_iou": "BEV IoU", "ate_m": "ATE (m)", "bev_iou_misses_zero": "BEV IoU, misses as 0"}


@dataclass(frozen=True)
class Recipe:
    """How a network is made: ``steps`` of fine-tuning on so many frames (None: all); 0 steps are the bundled one.

    Boxes are placed as by a job with this method, unless ``decode`` says.
    """

    steps: int = 0
    method: str = "lifted"
    decode: Decode | None = None
    frames: int | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Of fine-tuning."""
        placed = {} if self.decode is None else {"decode": self.decode}
        return {"steps": self.steps, "method": self.method, **placed}


RECIPES = {
    "baseline": Recipe(),
    "baseline_plane": Recipe(decode="plane"),
    "baseline_depth": Recipe(decode="depth"),
    "lifted_20": Recipe(20),
    "lifted_60": Recipe(60),
    "lifted_150": Recipe(150),
    "lifted_350": Recipe(350),
    "lifted_1200": Recipe(1200),
    "lifted_8_frames": Recipe(100, frames=8),
    "lifted_40_frames": Recipe(100, frames=40),
    "paper_200": Recipe(200, method="paper"),
}


def made_by(site: Site, recipe: Recipe) -> Trained:
    """The network of a recipe; where all frames teach it, as a job trains it, whose network may be there already."""
    if not recipe.steps:
        return untrained(site, recipe.decode or site.usual_decode)
    if recipe.frames is None:
        return finetuned_by_stage(site, recipe.options)
    train, validation = (views(site, part, site.lifts) for part in ("train", "val"))
    few = train[:: max(1, len(train) // recipe.frames)][: recipe.frames]
    return finetuned_on(site, few, validation, FinetuneConfig(**recipe.options))


def row(site: Site, run: Run) -> Figures:
    """The figures of one network."""
    return {"chosen_on": chosen_on(site.number), **figures(site, made_by(site, Recipe(**run["recipe"])))}


def both_sides(rows: Sequence[Row]) -> list[Row]:
    """What needs no label beside the truth, of networks; rows without, as of labels, are left out."""
    return [{**row, **row["consistency"]} for row in rows if "consistency" in row]


@dataclass(frozen=True)
class Correlation:
    """Of n pairs; NaN below three or where one side never changes."""

    pearson: float
    spearman: float
    n: int

    def __str__(self) -> str:
        return "–" if np.isnan(self.spearman) else f"{self.spearman:.2f} / {self.pearson:.2f} ({self.n})"

    @classmethod
    def of(cls, pairs: Sequence[tuple[float | None, float | None]]) -> Correlation:
        known = np.array([pair for pair in pairs if None not in pair], dtype=np.float64).reshape(-1, 2)
        if len(known) < 3 or (np.ptp(known, axis=0) == 0).any():
            return cls(np.nan, np.nan, len(known))
        return cls(float(stats.pearsonr(*known.T)[0]), float(stats.spearmanr(*known.T)[0]), len(known))


def among_networks(rows: Sequence[Row], measure: str, truth: str) -> Correlation:
    """Over all networks of all sites."""
    return Correlation.of([(mean_of(row, measure), mean_of(row, truth)) for row in rows])


def within_groups(groups: Sequence[Sequence[Row]], measure: str, truth: str) -> Correlation:
    """Mean of the correlations in each group; n counts the groups that have one."""
    found = [among_networks(group, measure, truth) for group in groups]
    known = [one for one in found if np.isfinite(one.spearman)]
    if not known:
        return Correlation(np.nan, np.nan, 0)
    return Correlation(
        float(np.mean([one.pearson for one in known])), float(np.mean([one.spearman for one in known])), len(known)
    )


def same_site(rows: Sequence[Row]) -> list[list[Row]]:
    """The rows of each site."""
    return [[row for row in rows if row["run"]["site"] == site] for site in sorted({r["run"]["site"] for r in rows})]


def document(rows: Sequence[Row], command: str) -> str:
    """Markdown: correlations, and the networks that they rest on."""
    heads = ("measure", "truth", "all networks", "networks of one site", "vehicles of one network", "all vehicles")
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    vehicles = [row["vehicles"] for row in rows]
    everyone = [one for of in vehicles for one in of]
    for measure, measured in MEASURES.items():
        for truth, title in TRUTHS.items():
            cells = [among_networks(rows, measure, truth), within_groups(same_site(rows), measure, truth)]
            if truth in OF_VEHICLE:
                cells += [within_groups(vehicles, measure, truth), among_networks(everyone, measure, truth)]
            shown = [str(one) for one in cells] + ["–"] * (4 - len(cells))
            lines.append(f"| {measured} | {title} | {' | '.join(shown)} |")
    columns = ("site", "network", *MEASURES.values(), *TRUTHS.values(), "vehicles")
    table = [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
    for row in rows:
        values = [mean_of(row, name) for name in (*MEASURES, *TRUTHS)]
        shown = ["–" if value is None else f"{value:.3f}" for value in values]
        table.append(
            f"| {row['run']['site']} | {row['run']['method']} | {' | '.join(shown)} | {len(row['vehicles'])} |"
        )
    about = (
        "Spearman's / Pearson's correlation (number of pairs; of one site or network: mean over so many). IoU in "
        f"other views should rise with BEV IoU and fall with ATE, roughness the other way round. {caveats(rows)}"
    )
    parts = ("# Does self-consistency tell the true error?", about, f"    {command}", "\n".join(lines))
    return "\n\n".join((*parts, "\n".join(table), "![networks and vehicles](self-consistency.png)\n"))


def scatter_figure(rows: Sequence[Row]) -> Figure:
    """Above the networks, below their vehicles: each measure against BEV IoU and ATE; a colour for each site."""
    figure = new_figure(11.0, 5.6)
    panels = figure.subplots(2, len(MEASURES) * len(OF_VEHICLE))
    pairs = [(measure, truth) for measure in MEASURES for truth in OF_VEHICLE]
    for column, (measure, truth) in enumerate(pairs):
        for number, of_site in enumerate(same_site(rows)):
            colour, label = camera_colour(number), f"site {of_site[0]['run']['site']}"
            points = [(mean_of(row, measure), mean_of(row, truth)) for row in of_site]
            panels[0, column].plot(*_known(points), "o", color=colour, markersize=5, label=label)
            points = [(one[measure], one[truth]) for row in of_site for one in row["vehicles"]]
            panels[1, column].plot(*_known(points), ".", color=colour, markersize=3, alpha=0.35)
        for axes, title in ((panels[0, column], "networks"), (panels[1, column], "vehicles")):
            tidy(axes, title=title, x=MEASURES[measure], y=TRUTHS[truth], grid="both")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=8, fontsize=8.5, frameon=False)
    return figure


def _known(points: Sequence[tuple[float | None, float | None]]) -> tuple[list[float], list[float]]:
    known = [(x, y) for x, y in points if x is not None and y is not None]
    return [x for x, _ in known], [y for _, y in known]


def runs_of(arguments: argparse.Namespace) -> Iterator[Run]:
    """One run a site and network."""
    for number in arguments.sites:
        for name in arguments.networks:
            recipe = replace(RECIPES[name], steps=min(RECIPES[name].steps, arguments.most_steps))
            yield {"site": number, "method": name, **recording_of(arguments), "recipe": vars(recipe)}


def main() -> None:
    parser = site_parser(__doc__, sites=[11, 12, 21, 22], seconds=90.0)
    parser.add_argument("--networks", nargs="*", choices=RECIPES, default=list(RECIPES), help="to be made here")
    parser.add_argument("--most-steps", type=int, default=1200, help="no network is trained for longer")
    parser.add_argument(
        "--with",
        dest="others",
        type=Path,
        nargs="+",
        default=[],
        metavar="FILE",
        help="compare the networks of these rows of benchmarks.learning, too",
    )
    arguments = parser.parse_args()
    made: list[Row] = []
    for one in made_rows(arguments, "self-consistency", runs_of(arguments), row):
        made.append(one)
        print(
            {**one["run"], **{name: mean_of(both_sides([one])[0], name) for name in (*MEASURES, *TRUTHS)}}, flush=True
        )
    asked = ("sites", "most_steps", *recording_of(arguments)) if arguments.networks else ()
    typed = {name: getattr(arguments, name) for name in ("networks", *asked)}
    rows = both_sides([*made, *joined(arguments.others)])
    with_others = {"with": [path.as_posix() for path in arguments.others] or None}
    text = document(rows, command_of("self_consistency", **typed, **with_others))
    (arguments.out / "self-consistency.md").write_text(text, encoding="utf-8")
    save(scatter_figure(rows), arguments.out / "self-consistency.png")
    print(text)


if __name__ == "__main__":
    main()
