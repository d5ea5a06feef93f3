"""How the fits' errors grow with errors of the calibration and of the clocks that nothing refines.

Every camera is turned by an angle about a random axis, or its clock is set wrong by a random offset, between detection
and association; association and the fits are run again, and the fits of the training part are compared with the truth.
The same frames stay together at an instant whatever the clocks say. Several random draws each. With ``--train`` a
network is fine-tuned on each draw's fits, too, and measured on the test part through the disturbed cameras. Writes
``robustness.json`` (a killed run goes on where it was), ``robustness.md`` and ``robustness.png``.

Run: python -m benchmarks.robustness --sites 11 12 --draws 3 --seconds 90 --out docs [--train --steps 350]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np
from matplotlib.figure import Figure

from benchmarks.learning_options import command_of, made_rows, recording_of, site_parser
from benchmarks.learning_report import caveats, save
from benchmarks.learning_rows import Row, Run, mean_of
from benchmarks.learning_sites import Figures, Site, figures, finetuned_on, label_figures, views
from benchmarks.looks import chosen_on
from wibam_core.artifacts import catalogue
from wibam_core.association.associate import associate
from wibam_core.config import AssociateConfig, DatasetConfig, FinetuneConfig, LiftConfig
from wibam_core.dataset.split import split_in_time
from wibam_core.detection.instants import annotated
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.lifting.instants import thinned, within_split
from wibam_core.lifting.lift import lift
from wibam_core.report.style import FINETUNED, TRUTH, new_figure, tidy
from wibam_core.scene import AnnotatedInstant, CameraRig

POSES_DEG = (0.1, 0.3, 1.0)
CLOCKS_MS = (10.0, 20.0, 60.0)
#: Kind of disturbance -> title of its axis.
KINDS = {"pose_deg": "rotation of each camera (°)", "clock_ms": "s.d. of each clock's offset (ms)"}
#: Name in a row -> title.
SHOWN = {"ate_m": "ATE (m)", "bev_iou": "BEV IoU", "aoe_deg": "AOE (°)"}


def turned(camera: Camera, angle_deg: float, rng: np.random.Generator) -> Camera:
    """The camera, turned about its centre by ``angle_deg`` about a random axis."""
    axis = rng.normal(size=3)
    rotation = cv2.Rodrigues(np.radians(angle_deg) * axis / np.linalg.norm(axis))[0]
    pose = camera.T_world_cam
    return replace(camera, T_world_cam=SE3(pose.rotation @ rotation, pose.translation))


def with_wrong_poses(rig: CameraRig, angle_deg: float, rng: np.random.Generator) -> CameraRig:
    """Every camera turned by ``angle_deg``, each about its own axis."""
    return CameraRig({camera_id: turned(camera, angle_deg, rng) for camera_id, camera in rig.items()})


def with_wrong_clocks(
    instants: Sequence[AnnotatedInstant], rig: CameraRig, sd_ms: float, rng: np.random.Generator
) -> list[AnnotatedInstant]:
    """Frames said to be exposed at wrong times: by one offset for each camera but the reference."""
    late_ns = {camera_id: round(1e6 * sd_ms * rng.normal()) for camera_id in rig if camera_id != rig.reference_id}
    return [
        replace(
            instant,
            detections={
                camera_id: replace(seen, frame_time_ns=seen.frame_time_ns + late_ns.get(camera_id, 0))
                for camera_id, seen in instant.detections.items()
            },
        )
        for instant in instants
    ]


def refitted(site: Site, rig: CameraRig, detected: Sequence[AnnotatedInstant]) -> Site:
    """The site as it is with these cameras and times: what a job's stages from association to the fits make of it."""
    instants = associate(detected, rig, AssociateConfig())
    split = split_in_time(instants, DatasetConfig())
    lifted = lift(thinned(instants, split, LiftConfig().rate_hz), rig, LiftConfig()).vehicles
    return replace(site, rig=rig, instants=instants, lifts=within_split(lifted, split), split=split)


def disturbed(site: Site, kind: str, amount: float, draw: int) -> Site:
    """The site with one draw of a disturbance."""
    rng = np.random.default_rng([site.number, draw, list(KINDS).index(kind)])
    searched, boxes = site.outputs.read(catalogue.SEARCHED_INSTANTS), site.outputs.read(catalogue.DETECTIONS)
    detected = annotated(searched, boxes)
    if kind == "pose_deg":
        return refitted(site, with_wrong_poses(site.rig, amount, rng), detected)
    return refitted(site, site.rig, with_wrong_clocks(detected, site.rig, amount, rng))


def row(site: Site, run: Run) -> Figures:
    """The figures of one draw."""
    wrong = disturbed(site, run["kind"], run["amount"], run["draw"])
    found: Figures = {"chosen_on": chosen_on(site.number), **label_figures(wrong)}
    if run["finetune"] is not None:
        train, validation = (views(wrong, part, wrong.lifts) for part in ("train", "val"))
        trained = finetuned_on(wrong, train, validation, FinetuneConfig(**run["finetune"]))
        found["trained"] = figures(wrong, trained)
    return found


def runs_of(arguments: argparse.Namespace) -> Iterator[Run]:
    """Every draw of every amount of both kinds; nothing is disturbed by an amount of 0, once a site."""
    amounts = {"pose_deg": arguments.poses_deg, "clock_ms": arguments.clocks_ms}
    for number in arguments.sites:
        for kind in KINDS:
            for amount in (0.0, *amounts[kind]):
                for draw in range(arguments.draws if amount else 1):
                    yield {
                        "site": number,
                        "kind": kind,
                        "amount": amount,
                        "draw": draw,
                        **recording_of(arguments),
                        "finetune": {"steps": arguments.steps, "seed": 0} if arguments.train else None,
                    }


def spread_of(
    rows: Sequence[Row], kind: str, amount: float, name: str, *, trained: bool = False
) -> tuple[float, float, int]:
    """Mean and s.d. over sites and draws of a figure, and how many there are; NaN where there are too few."""
    mine = [row for row in rows if row["run"]["kind"] == kind and row["run"]["amount"] == amount]
    found = [mean_of(row.get("trained", {}) if trained else row, name) for row in mine]
    known = [value for value in found if value is not None]
    mean = float(np.mean(known)) if known else np.nan
    return mean, float(np.std(known, ddof=1)) if len(known) > 1 else np.nan, len(known)


def document(rows: Sequence[Row], command: str) -> str:
    """Markdown: one table for each kind."""
    sites = ", ".join(str(site) for site in sorted({row["run"]["site"] for row in rows}))
    parts = [
        "# What wrong calibrations and clocks cost",
        f"Fits to all views against the truth, nothing refined; sites: {sites}; mean ± s.d. over sites and draws. "
        f"{caveats(rows)}",
        f"    {command}",
    ]
    has_trained = any("trained" in row for row in rows)
    for kind, title in KINDS.items():
        heads = [title, "runs", *SHOWN.values(), "fits that are a vehicle"]
        heads += [f"trained: {name}" for name in SHOWN.values()] if has_trained else []
        lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
        for amount in sorted({row["run"]["amount"] for row in rows if row["run"]["kind"] == kind}):
            names = [*((name, False) for name in (*SHOWN, "matched")), *((name, True) for name in SHOWN if has_trained)]
            cells = [_cell(*spread_of(rows, kind, amount, name, trained=trained)[:2]) for name, trained in names]
            count = spread_of(rows, kind, amount, "ate_m")[2]
            lines.append(f"| {amount:g} | {count} | {' | '.join(cells)} |")
        parts.append("\n".join(lines))
    return "\n\n".join((*parts, "![curves](robustness.png)\n"))


def _cell(mean: float, sd: float) -> str:
    if np.isnan(mean):
        return "–"
    digits = 0 if mean > 100 else 1 if mean > 10 else 2
    return f"{mean:.{digits}f}" + ("" if np.isnan(sd) else f" ± {sd:.{digits}f}")


def curves_figure(rows: Sequence[Row]) -> Figure:
    """ATE over the amount of each kind, of the fits and of networks trained on them."""
    figure = new_figure(8.6, 3.4)
    for axes, (kind, title) in zip(figure.subplots(1, 2, sharey=True), KINDS.items(), strict=True):
        amounts = sorted({row["run"]["amount"] for row in rows if row["run"]["kind"] == kind})
        for trained, label, colour in ((False, "fits", TRUTH), (True, "network trained on them", FINETUNED)):
            found = [spread_of(rows, kind, amount, "ate_m", trained=trained) for amount in amounts]
            if any(count for _, _, count in found):
                means, spreads = [mean for mean, _, _ in found], [np.nan_to_num(sd) for _, sd, _ in found]
                axes.errorbar(amounts, means, spreads, fmt="o-", color=colour, capsize=3, label=label)
        tidy(axes, x=title, y="ATE (m)" if kind == "pose_deg" else "", grid="both")
        axes.set_ylim(bottom=0)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8.5, frameon=False)
    return figure


def main() -> None:
    parser = site_parser(__doc__, sites=[11, 12], seconds=90.0)
    parser.add_argument("--poses-deg", type=float, nargs="+", default=list(POSES_DEG))
    parser.add_argument("--clocks-ms", type=float, nargs="+", default=list(CLOCKS_MS))
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--train", action="store_true", help="also fine-tune on every draw's fits")
    parser.add_argument("--steps", type=int, default=350)
    arguments = parser.parse_args()
    rows: list[Row] = []
    for made in made_rows(arguments, "robustness", runs_of(arguments), row):
        rows.append(made)
        print({**made["run"], **{name: mean_of(made, name) for name in SHOWN}}, flush=True)
    typed = ["sites", "draws", "poses_deg", "clocks_ms", *recording_of(arguments), "train"]
    typed += ["steps"] * arguments.train
    text = document(rows, command_of("robustness", **{name: getattr(arguments, name) for name in typed}))
    (arguments.out / "robustness.md").write_text(text, encoding="utf-8")
    save(curves_figure(rows), arguments.out / "robustness.png")
    print(text)


if __name__ == "__main__":
    main()
