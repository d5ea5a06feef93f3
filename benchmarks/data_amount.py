"""How much footage is enough: fine-tuning on the first part of the training footage, as many steps, the same test part.

As in the published study of the amount of data (Howe et al. 2021, figure 4), but that vehicles are counted, too. The
fits are those of a job on the whole recording, whose body templates, sizes and edge noise rest on all of it: a part of
the footage alone would give worse fits, so that small shares are flattered. Writes ``data-amount.json`` (a killed run
goes on where it was), ``data-amount.md`` and ``data-amount.png``.

Run: python -m benchmarks.data_amount --sites 11 12 --seeds 0 1 --seconds 300 --out docs
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.figure import Figure

from benchmarks.learning_options import command_of, made_rows, recording_of, site_parser
from benchmarks.learning_report import caveats, save, share_of_gain
from benchmarks.learning_rows import Row, Run, mean_of
from benchmarks.learning_sites import (
    Figures,
    Site,
    figures,
    finetuned_by_stage,
    finetuned_on,
    untrained,
    views,
)
from benchmarks.looks import chosen_on
from wibam_core.config import FinetuneConfig
from wibam_core.report.style import BASELINE, FINETUNED, new_figure, tidy

SHARES = (0.1, 0.25, 0.5, 1.0)
#: Name in a row -> title.
SHOWN = {"bev_iou": "BEV IoU", "ate_m": "ATE (m)", "recall": "recall", "bev_iou_misses_zero": "BEV IoU, misses as 0"}
#: What the document says of the labels.
FITS = (
    "Labels are the fits to the whole recording: their body templates, sizes and edge noise rest on more footage than "
    "the share, which flatters small shares."
)
#: The gain is judged by it: it counts what is found and how well.
JUDGED = "bev_iou_misses_zero"


def runs_of(arguments: argparse.Namespace) -> Iterator[Run]:
    """One run a site, seed and share; a share of 0 is the baseline."""
    for number in arguments.sites:
        for seed in arguments.seeds:
            for share in (0.0, *arguments.shares):
                yield {
                    "site": number,
                    "seed": seed,
                    "share": share,
                    **recording_of(arguments),
                    "finetune": {"seed": seed, "steps": arguments.steps},
                }


def row(site: Site, run: Run) -> Figures:
    """The figures of a network that learned from the first share of the training part."""
    share = run["share"]
    about: Figures = {"chosen_on": chosen_on(site.number), "minutes": share * site.minutes, "vehicles": 0}
    if share == 0:
        return {**about, **figures(site, untrained(site, site.usual_decode))}
    train, validation = (views(site, part, site.lifts) for part in ("train", "val"))
    times = site.split.times_ns["train"]
    last_ns = times[max(1, round(share * len(times))) - 1]
    first_part = [view for view in train if view.time_ns <= last_ns]
    taught = {track for lifts in site.lifts if times[0] <= lifts.time_ns <= last_ns for track in lifts.ids.tolist()}
    options = run["finetune"]
    # all of it: as a job does, whose network may be there already
    trained = (
        finetuned_by_stage(site, options)
        if share == 1
        else finetuned_on(site, first_part, validation, FinetuneConfig(**options))
    )
    vehicles = len(taught - site.split.left_out_tracks["train"])
    return {**about, "vehicles": vehicles, **figures(site, trained)}


def gains(rows: Sequence[Row]) -> dict[float, list[float]]:
    """Share of the footage -> shares of the full gain in `JUDGED`, one a site and seed."""
    found: dict[float, list[float]] = {}
    for mine in _by_place(rows):
        start, full = mine.get(0.0), mine.get(1.0)
        if start is None or full is None:
            continue
        for share, one in mine.items():
            gain = share_of_gain(one, start, full, JUDGED)
            if gain is not None and share > 0:
                found.setdefault(share, []).append(gain)
    return found


def gain_after(rows: Sequence[Row], minutes: float) -> float | None:
    """Mean share of the full gain with so many minutes, between the amounts tried; None beyond them."""
    found = []
    for mine in _by_place(rows):
        if 0.0 not in mine or 1.0 not in mine or not minutes <= mine[1.0]["minutes"]:
            continue
        tried = sorted(mine.values(), key=lambda one: one["minutes"])
        shares = [share_of_gain(one, mine[0.0], mine[1.0], JUDGED) or 0.0 for one in tried]
        if any(shares):
            found.append(float(np.interp(minutes, [one["minutes"] for one in tried], shares)))
    return float(np.mean(found)) if found else None


def minutes_for(rows: Sequence[Row], gain: float) -> float | None:
    """Mean over the places of the least amount tried, in minutes, that gave that share of the full gain."""
    found = []
    for mine in _by_place(rows):
        start, full = mine.get(0.0), mine.get(1.0)
        if start is None or full is None:
            continue
        gained = {one["minutes"]: share_of_gain(one, start, full, JUDGED) or 0.0 for one in mine.values()}
        found += sorted(minutes for minutes, share in gained.items() if share >= gain)[:1]
    return float(np.mean(found)) if found else None


def advice(rows: Sequence[Row]) -> str:
    """What a person who plans a recording should know."""
    sentences = []
    one_minute = gain_after(rows, 1.0)
    if one_minute is not None:
        sentences.append(f"One minute of footage to learn from gave {100 * one_minute:.0f} % of the full gain.")
    enough = minutes_for(rows, 0.9)
    if enough is not None:
        sentences.append(f"The least amount tried that gave nine tenths of it was {enough:.1f} min.")
    full = [row for row in rows if row["run"]["share"] == 1.0]
    minutes, vehicles = (np.mean([row[name] for row in full]) for name in ("minutes", "vehicles"))
    sentences.append(f"The full amount was {minutes:.1f} min with {vehicles:.0f} vehicles on average.")
    return " ".join(sentences)


def document(rows: Sequence[Row], command: str) -> str:
    """Markdown: the table and what it advises."""
    lines = ["| share | minutes | vehicles | runs | " + " | ".join(SHOWN.values()) + " | share of the full gain |"]
    lines.append("|" + "---|" * (5 + len(SHOWN)))
    gained = gains(rows)
    for share in sorted({row["run"]["share"] for row in rows}):
        mine = [row for row in rows if row["run"]["share"] == share]
        cells = [_cell([mean_of(row, name) for row in mine], 3) for name in SHOWN]
        about = (
            f"{100 * share:g} %",
            _cell([row["minutes"] for row in mine], 2),
            _cell([row["vehicles"] for row in mine], 0),
        )
        lines.append(f"| {' | '.join((*about, str(len(mine)), *cells, _cell(gained.get(share, []), 2)))} |")
    sites = ", ".join(str(site) for site in sorted({row["run"]["site"] for row in rows}))
    title = "# How much footage is enough"
    rest_on = (
        f"Sites: {sites}. Means of the runs ± their standard deviation; the gain is that in {SHOWN[JUDGED]}. {FITS} "
        f"{caveats(rows)}"
    )
    return "\n\n".join(
        (title, advice(rows), rest_on, f"    {command}", "\n".join(lines), "![curve](data-amount.png)\n")
    )


def curve_figure(rows: Sequence[Row]) -> Figure:
    """The metrics over the minutes learned from: every run, and the mean of each share."""
    figure = new_figure(11.0, 3.2)
    shares = sorted({row["run"]["share"] for row in rows})
    for axes, (name, title) in zip(figure.subplots(1, len(SHOWN)), SHOWN.items(), strict=True):
        for mine in _by_place(rows):
            ordered = [mine[share] for share in sorted(mine)]
            minutes, values = [one["minutes"] for one in ordered], [mean_of(one, name) for one in ordered]
            axes.plot(minutes, values, color=FINETUNED, alpha=0.35, linewidth=1)
        of_share = [[row for row in rows if row["run"]["share"] == share] for share in shares]
        means = [np.mean([mean_of(row, name) or 0.0 for row in of]) for of in of_share]
        at = [np.mean([row["minutes"] for row in of]) for of in of_share]
        axes.plot(at, means, "o-", color=FINETUNED, label="fine-tuned")
        axes.axhline(means[0], color=BASELINE, linestyle="--", linewidth=1.2, label="baseline")
        tidy(axes, title=title, x="footage learned from (min)")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8.5, frameon=False)
    return figure


def _by_place(rows: Sequence[Row]) -> list[dict[float, Row]]:
    """Per site and seed: share -> row."""
    found: dict[tuple[int, int], dict[float, Row]] = {}
    for one in rows:
        found.setdefault((one["run"]["site"], one["run"]["seed"]), {})[one["run"]["share"]] = one
    return list(found.values())


def _cell(values: Sequence[float | None], digits: int) -> str:
    known = [value for value in values if value is not None]
    if not known:
        return "–"
    spread = f" ± {np.std(known, ddof=1):.{digits}f}" if len(known) > 1 else ""
    return f"{np.mean(known):.{digits}f}{spread}"


def main() -> None:
    parser = site_parser(__doc__, sites=[11, 12], seconds=300.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--shares", type=float, nargs="+", default=list(SHARES))
    parser.add_argument("--steps", type=int, default=FinetuneConfig().steps)
    arguments = parser.parse_args()
    rows: list[Row] = []
    for made in made_rows(arguments, "data-amount", runs_of(arguments), row):
        rows.append(made)
        about = {"run": made["run"], "minutes": made["minutes"], **{name: mean_of(made, name) for name in SHOWN}}
        print(about, flush=True)
    typed = ("sites", "seeds", "shares", *recording_of(arguments), "steps")
    text = document(rows, command_of("data_amount", **{name: getattr(arguments, name) for name in typed}))
    (arguments.out / "data-amount.md").write_text(text, encoding="utf-8")
    save(curve_figure(rows), arguments.out / "data-amount.png")
    print(text)


if __name__ == "__main__":
    main()
