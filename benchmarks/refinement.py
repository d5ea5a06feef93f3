"""What refining the calibration by the traffic gains: the fits' errors with wrong cameras, before and after.

Every camera of a simulated site is turned by an angle about a random axis between detection and association, and the
stages from there to the fits are run with these cameras, and with what `wibam_core.refinement` makes of them. The fits
of the training part are compared with the truth. Writes ``refinement.json`` (a killed run goes on where it was).

Run: python -m benchmarks.refinement --sites 503 --draws 2 --seconds 120 --out build/learning
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator

import numpy as np

from benchmarks.learning_options import made_rows, recording_of, site_parser
from benchmarks.learning_rows import Run, mean_of
from benchmarks.learning_sites import Figures, Site, label_figures
from benchmarks.robustness import refitted, with_wrong_poses
from wibam_core.artifacts import catalogue
from wibam_core.config import RefineConfig
from wibam_core.detection.instants import annotated
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.refinement.refine import refine

POSES_DEG = (0.0, 0.1, 0.3, 1.0)


def row(site: Site, run: Run) -> Figures:
    """The figures of one draw."""
    rng = np.random.default_rng([site.number, run["draw"], 0])
    rig = with_wrong_poses(site.rig, run["amount"], rng) if run["amount"] else site.rig
    detected = annotated(site.outputs.read(catalogue.SEARCHED_INSTANTS), site.outputs.read(catalogue.DETECTIONS))
    start = time.process_time()
    refined = refine(detected, rig, CalibrationResiduals(cameras={}), RefineConfig(method="traffic"))
    seconds = time.process_time() - start
    return {
        "before": label_figures(refitted(site, rig, detected)),
        "after": label_figures(refitted(site, refined.rig, detected)),
        "refinement": refined.document.model_dump(exclude={"covariances"}),
        "cpu_s": seconds,
    }


def runs_of(arguments: argparse.Namespace) -> Iterator[Run]:
    """Every draw of every angle; nothing is turned by 0, once a site."""
    for number in arguments.sites:
        for amount in arguments.poses_deg:
            for draw in range(arguments.draws if amount else 1):
                yield {"site": number, "amount": amount, "draw": draw, **recording_of(arguments)}


def main() -> None:
    parser = site_parser(__doc__, sites=[503], seconds=120.0)
    parser.add_argument("--poses-deg", type=float, nargs="+", default=list(POSES_DEG))
    parser.add_argument("--draws", type=int, default=2)
    arguments = parser.parse_args()
    print("| site | turned by (°) | ATE before (m) | after | fits that are a vehicle | after | gain held out | taken |")
    print("|---|---|---|---|---|---|---|---|")
    for made in made_rows(arguments, "refinement", runs_of(arguments), row):
        run, before, after, found = made["run"], made["before"], made["after"], made["refinement"]
        judged = found["held_out"]
        gain = f"{100 * judged['gain']:.0f} ± {100 * judged['gain_sd']:.0f} %" if judged else "–"
        print(
            f"| {run['site']} | {run['amount']:g} | {mean_of(before, 'ate_m'):.2f} | {mean_of(after, 'ate_m'):.2f} "
            f"| {before['matched']} | {after['matched']} | {gain} | {'yes' if found['taken'] else 'no'} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
