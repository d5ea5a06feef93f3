"""What fine-tuning gains, and how: methods side by side on simulated sites.

Rows per site and seed:

- ``baseline``: the bundled network, placed by the ground plane, and ``baseline_depth``: by its own depth.
- the methods of `TRAINED`, among them ``paper``: fine-tuned with the published loss (Howe et al. 2021, eq. 1), and
  ``lifted``: fine-tuned on the fits to all views, the default.
- ``truth``: the same training on the true boxes of the same vehicles: what better labels could give.
- ``labels``: the fits themselves, in the training part.

Each network is measured on all frames of the held-out part of its site, as a job measures it. Writes ``learning.json``
(rows, each as soon as it is made: a killed run goes on where it was), ``learning.md`` and figures.

Run: python -m benchmarks.learning --sites 501 502 --seeds 0 --seconds 90 --steps 350 --out docs
Short, about five minutes on two idle cores: python -m benchmarks.learning --short
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.learning_report import document, draw, table
from benchmarks.learning_rows import Row, RowFile, Run
from benchmarks.learning_sites import (
    CHOSEN_ON,
    Figures,
    Site,
    Trained,
    bundled_network,
    figures,
    finetuned_by_stage,
    finetuned_on,
    label_figures,
    make_site,
    true_lifts,
    views,
)
from wibam_core.config import FinetuneConfig
from wibam_core.models.decode import Decode

#: Method -> options of fine-tuning.
TRAINED: Mapping[str, Mapping[str, Any]] = {
    "paper": {"method": "paper"},
    "paper_own_view": {"method": "paper", "own_view": True},
    "paper_box_heads": {"method": "paper", "box_heads": True},
    "paper_code": {"method": "paper", "own_view": True, "box_heads": True, "decode": "depth"},
    "lifted": {"method": "lifted"},
    "lifted_depth": {"method": "lifted", "decode": "depth"},
    "lifted_fused": {"method": "lifted", "decode": "fused"},
    "combined": {"method": "combined"},
}
METHODS = ("baseline_depth", "baseline", *TRAINED, "truth", "labels")
DEFAULT_METHODS = ("baseline_depth", "baseline", "paper", "lifted", "truth", "labels")


def runs_of(arguments: argparse.Namespace) -> Iterator[Run]:
    """What there is to run."""
    for number in arguments.sites:
        for seed in arguments.seeds:
            for method in arguments.methods:
                yield {
                    "site": number,
                    "seed": seed,
                    "method": method,
                    "seconds": arguments.seconds,
                    "density": arguments.density,
                    "finetune": options_of(method, seed, arguments.steps),
                }


def options_of(method: str, seed: int, steps: int) -> dict[str, Any] | None:
    """Options of fine-tuning; None where nothing is trained."""
    if method == "labels" or method.startswith("baseline"):
        return None
    return {**TRAINED.get(method, {"method": "lifted"}), "seed": seed, "steps": steps}


def row(site: Site, run: Run) -> Figures:
    """The figures of a method."""
    about = {"chosen_on": site.number in CHOSEN_ON, "minutes": site.minutes}
    if run["method"] == "labels":
        return {**about, "decode": "plane", **label_figures(site)}
    trained = trained_by(site, run["method"], run["finetune"])
    return {**about, "decode": trained.decode, **figures(site, trained)}


def trained_by(site: Site, method: str, options: Mapping[str, Any] | None) -> Trained:
    """The network of a method, trained where it is to be trained."""
    if options is None:
        decode: Decode = "depth" if method == "baseline_depth" else "plane"
        return bundled_network(decode)
    if method != "truth":
        return finetuned_by_stage(site, options)
    train, validation = (views(site, part, true_lifts(site)) for part in ("train", "val"))
    return finetuned_on(site, train, validation, FinetuneConfig(**options))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, nargs="+", default=[501, 502, 503])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--density", type=float, default=1.2)
    parser.add_argument("--steps", type=int, default=350)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(DEFAULT_METHODS))
    parser.add_argument("--short", action="store_true", help="site 11, 40 s, 80 steps")
    parser.add_argument("--fresh", action="store_true", help="forget the rows that were made before")
    parser.add_argument("--cache", type=Path, default=Path("build/learning"))
    parser.add_argument("--out", type=Path, default=Path("build/learning"))
    arguments = parser.parse_args()
    if arguments.short:
        arguments.sites, arguments.seeds, arguments.seconds, arguments.steps = [11], [0], 40.0, 80
    return arguments


def command_of(arguments: argparse.Namespace) -> str:
    """What to type for the same rows."""
    lists = {name: " ".join(map(str, getattr(arguments, name))) for name in ("sites", "seeds", "methods")}
    return (
        f"python -m benchmarks.learning --sites {lists['sites']} --seeds {lists['seeds']} "
        f"--seconds {arguments.seconds:g} --density {arguments.density:g} --steps {arguments.steps} "
        f"--methods {lists['methods']}"
    )


def main() -> None:
    arguments = parse()

    @cache
    def site_of(number: int) -> Site:
        return make_site(number, arguments.seconds, arguments.density, arguments.cache)

    file = RowFile(arguments.out / "learning.json", fresh=arguments.fresh)
    rows: list[Row] = []
    for made in file.rows(runs_of(arguments), lambda run: row(site_of(run["site"]), run)):
        rows.append(made)
        print(f"site {made['run']['site']}, seed {made['run']['seed']}\n{table([made])}", flush=True)
    (arguments.out / "learning.md").write_text(document(rows, command_of(arguments)), encoding="utf-8")
    draw(rows, arguments.out)
    print(document(rows, command_of(arguments)))


if __name__ == "__main__":
    main()
