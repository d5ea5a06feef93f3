"""What fine-tuning gains, and how: methods side by side on simulated sites.

Rows per site and seed:

- ``baseline``: the bundled network, its boxes placed as those of the fine-tuned one; ``baseline_plane``: by the ground
  plane; ``baseline_depth``: by its own depth.
- the methods of `TRAINED`, among them ``paper``: fine-tuned with the published loss (Howe et al. 2021, eq. 1), and
  ``lifted``: fine-tuned on the fits to all views, the default.
- ``truth``: the same training on the true boxes of the same vehicles: what better labels could give.
- ``labels``: the fits themselves, in the training part.
- ``lifted_track``, ``labels_track``: fits to whole tracks that do not learn the site's bodies, and a network of theirs.

Each network is measured on all frames of the held-out part of its site, as a job measures it. Writes ``learning.json``
(rows, each as soon as it is made: a killed run goes on where it was), ``learning.md`` and figures, or so with another
``--name``. Rows that other code made are made again, but with ``--keep``; ``--draw`` joins the rows of files and runs
nothing.

Run: python -m benchmarks.learning --sites 501 502 --seeds 0 --seconds 240 --out docs
Short, about five minutes on two idle cores: python -m benchmarks.learning --short
Other methods at one site, beside the document of the usual ones:
python -m benchmarks.learning --sites 501 --seeds 0 --seconds 240 --methods baseline lifted lifted_track --name ablation
Full, with a CenterTrack network of yours, on a GPU where there is one:
python -m benchmarks.learning --network network.safetensors --seconds 600 --steps 6000 --seeds 0 1 2
Join: python -m benchmarks.learning --draw build/a/learning.json build/b/learning.json --out docs
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.learning_options import command_of, made_rows, recording_of, site_parser
from benchmarks.learning_report import document, draw, table
from benchmarks.learning_rows import Row, Run, joined, read_rows, width_px_of, write_rows
from benchmarks.learning_sites import (
    Figures,
    Site,
    Trained,
    figures,
    finetuned_by_stage,
    finetuned_on,
    fitted_by,
    label_figures,
    placed,
    true_lifts,
    untrained,
    views,
)
from benchmarks.looks import chosen_on
from wibam_core.config import FinetuneConfig
from wibam_core.placing import Decode
from wibam_core.stages.store import sha256_of

#: The network before training -> how its boxes are placed; None: as after it.
BASELINES: Mapping[str, Decode | None] = {"baseline_depth": "depth", "baseline_plane": "plane", "baseline": None}

#: Method -> options of fine-tuning.
TRAINED: Mapping[str, Mapping[str, Any]] = {
    "paper": {"method": "paper"},
    "paper_own_view": {"method": "paper", "own_view": True},
    "paper_box_heads": {"method": "paper", "box_heads": True},
    "paper_code": {"method": "paper", "own_view": True, "box_heads": True, "decode": "depth"},
    "lifted": {"method": "lifted"},
    "lifted_depth": {"method": "lifted", "decode": "depth"},
    "lifted_plane": {"method": "lifted", "decode": "plane"},
    "lifted_fused": {"method": "lifted", "decode": "fused"},
    "lifted_ground": {"method": "lifted", "decode": "ground"},
    "lifted_fitted": {"method": "lifted", "decode": "fitted"},
    "lifted_track": {"method": "lifted"},
    "combined": {"method": "combined"},
}
#: Method -> options of the fits, where they are not the usual ones.
LIFTED_BY: Mapping[str, Mapping[str, Any]] = {
    "lifted_track": {"learn_templates": False},
    "labels_track": {"learn_templates": False},
}
#: The fits themselves.
LABELS = ("labels", "labels_track")
METHODS = (*BASELINES, *TRAINED, "truth", *LABELS)
#: Ways to place boxes that a network is trained alike for.
_TRAINED_ALIKE = ("ground", "fitted", "refined")
#: Name of the files that are written, unless another is asked for.
_NAME = "learning"
#: How a network of the user's is named in commands that are written down; what a command's runs have in common.
_OWN_NETWORK = "network.safetensors"
_Common = tuple[float, float, int, str | None]
DEFAULT_METHODS = (*BASELINES, "paper", "lifted", "truth", "labels")


def runs_of(arguments: argparse.Namespace) -> Iterator[Run]:
    """What there is to run; a network of the user's is known by its digest."""
    network: Path | None = arguments.network
    own = {} if network is None else {"network": sha256_of(network)}
    for number in arguments.sites:
        for seed in arguments.seeds:
            for method in arguments.methods:
                yield {
                    "site": number,
                    "seed": seed,
                    "method": method,
                    **recording_of(arguments),
                    "finetune": options_of(method, seed, arguments.steps, custom=network is not None),
                    **({"lift": LIFTED_BY[method]} if method in LIFTED_BY else {}),
                    **own,
                }


def options_of(method: str, seed: int, steps: int, *, custom: bool = False) -> dict[str, Any] | None:
    """Options of fine-tuning; None where nothing is trained."""
    if method in LABELS or method in BASELINES:
        return None
    network = {"network": "custom"} if custom else {}
    return {**TRAINED.get(method, {"method": "lifted"}), **network, "seed": seed, "steps": steps}


def row(site: Site, run: Run) -> Figures:
    """The figures of a method."""
    about = {"chosen_on": chosen_on(site.number), "minutes": site.minutes}
    if run["method"] in LABELS:
        fitted = fitted_by(site, run["lift"]) if "lift" in run else site
        return {**about, "decode": "plane", **label_figures(fitted)}
    trained = trained_by(site, run["method"], run["finetune"], run.get("lift"))
    return {**about, "decode": trained.decode, **figures(site, trained)}


def trained_by(
    site: Site, method: str, options: Mapping[str, Any] | None, lift: Mapping[str, Any] | None = None
) -> Trained:
    """The network of a method, trained where it is to be trained, on fits by the options ``lift``."""
    if options is None:
        return untrained(site, BASELINES[method] or site.usual_decode)
    if options.get("decode") in _TRAINED_ALIKE:
        alike = {name: value for name, value in options.items() if name != "decode"}
        return placed(site, finetuned_by_stage(site, alike, lift), options["decode"])
    if method != "truth":
        return finetuned_by_stage(site, options, lift)
    train, validation = (views(site, part, true_lifts(site)) for part in ("train", "val"))
    return finetuned_on(site, train, validation, FinetuneConfig(**options))


def commands_of(rows: Sequence[Row], name: str | None = None) -> list[str]:
    """What to type for these rows, in files of this name: as few commands as there are kinds of runs."""
    places: dict[tuple[int, int, _Common], list[Run]] = {}
    for run in (row["run"] for row in rows):
        recording = (run["seconds"], run["density"], width_px_of(run))
        common = (*recording, _OWN_NETWORK if "network" in run else None)
        places.setdefault((run["site"], run["seed"], common), []).append(run)
    # what is run alike -> seed -> sites
    alike: dict[tuple[_Common, int | None, tuple[str, ...]], dict[int, list[int]]] = {}
    for (site, seed, common), runs in places.items():
        trained = sorted({run["finetune"]["steps"] for run in runs if run["finetune"] is not None})
        for steps in trained or [None]:
            mine = [run for run in runs if run["finetune"] is None or run["finetune"]["steps"] == steps]
            methods = tuple(sorted({run["method"] for run in mine}, key=_number))
            alike.setdefault((common, steps, methods), {}).setdefault(seed, []).append(site)
    commands = []
    for ((seconds, density, width_px, network), steps, methods), sites_of in alike.items():
        for sites in dict.fromkeys(map(tuple, sites_of.values())):
            options: dict[str, Any] = {"sites": sites, "seeds": [s for s, of in sites_of.items() if tuple(of) == sites]}
            options |= {"seconds": seconds, "density": density, "width_px": width_px, "steps": steps}
            options |= {"methods": methods, "network": network, "name": name}
            commands.append(command_of("learning", **options))
    return commands


def in_order(rows: Sequence[Row]) -> list[Row]:
    """As one command would have made them: by site, seed and method."""
    return sorted(rows, key=lambda row: (row["run"]["site"], row["run"]["seed"], _number(row["run"]["method"])))


def _number(method: str) -> int:
    """Place in the order of `METHODS`; those that there are no more come last."""
    return METHODS.index(method) if method in METHODS else len(METHODS)


def parse() -> argparse.Namespace:
    parser = site_parser(__doc__, sites=[501, 502, 503], seconds=90.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--steps", type=int, default=FinetuneConfig().steps)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(DEFAULT_METHODS))
    parser.add_argument(
        "--network", type=Path, metavar="FILE", help="fine-tune this DLA-34, as `wibam weights convert` writes it"
    )
    parser.add_argument("--name", default=_NAME, help="of the files that are written to --out")
    parser.add_argument("--short", action="store_true", help="site 11, 40 s at 640 px, 80 steps")
    parser.add_argument(
        "--draw",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="run nothing: join the rows of these files, of equal runs the first, and write all to --out",
    )
    arguments = parser.parse_args()
    if arguments.short:
        arguments.sites, arguments.seeds, arguments.seconds, arguments.width_px = [11], [0], 40.0, 640
        arguments.steps = 80
    return arguments


def made(arguments: argparse.Namespace) -> list[Row]:
    """The rows of all runs, each printed as soon as it is there."""
    rows = []
    for one in made_rows(arguments, arguments.name, runs_of(arguments), row):
        rows.append(one)
        print(f"site {one['run']['site']}, seed {one['run']['seed']}\n{table([one])}", flush=True)
    return rows


def drawn(arguments: argparse.Namespace) -> list[Row]:
    """The rows of the files that were asked for, also written to one file."""
    for path in arguments.draw:
        if not read_rows(path):
            raise SystemExit(f"{path}: no row says what was run")
    rows = in_order(joined(arguments.draw))
    write_rows(arguments.out / f"{arguments.name}.json", rows)
    return rows


def main() -> None:
    arguments = parse()
    rows = drawn(arguments) if arguments.draw else made(arguments)
    commands = commands_of(rows, None if arguments.name == _NAME else arguments.name)
    text = document(rows, "\n".join(commands), arguments.name)
    (arguments.out / f"{arguments.name}.md").write_text(text, encoding="utf-8")
    draw(rows, arguments.out, arguments.name)
    print(text)


if __name__ == "__main__":
    main()
