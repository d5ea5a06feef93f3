"""How well a job does at a real site, against hand labels: fits that teach, tracks, and single cameras.

For each detector and seed the pipeline runs in a folder that is kept, so that what was made before costs nothing, and a
row is written: what each round found, and how well the fits that teach, the tracks of all cameras, and the fine-tuned
network in single images agree with the labels, in all and by the part of the split in time that the labelled instant
lies in, with counts and intervals. Labels evaluate, and choose nothing within a run; what was chosen with them in sight
is in ``looks.json``.
Writes ``real-sites.json``, ``real-sites.md`` and ``real-sites.png``; nothing of the footage enters them.

Run: python -m benchmarks.real_sites SITE --labels LABELS.json --area AREA.json --runs build/real --detector bundled
     --seeds 0 1 2 --set finetune.steps=200 --out docs
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.real_labels import Area, Labels, figures, read_area, read_labels
from benchmarks.real_measures import (
    ONE_CAMERA_M,
    counts_in_area,
    detector_of,
    of_fits,
    of_one_camera,
    of_tracks,
    of_what_may_teach,
    parts,
)
from benchmarks.real_report import birds_eye, document, save
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.artifacts.catalogue import ANNOTATIONS, FITS, FRAMES, METRICS, RIG, ROUNDS, SPLIT, TRACKS
from wibam_core.cli.run import parse_options
from wibam_core.config import PipelineConfig
from wibam_core.stages.runner import SiteFolder, StageUpdate, latest, run_pipeline
from wibam_core.stages.store import StageStore

Row = dict[str, Any]

#: What says which run a row is of.
_KEY = ("site", "version", "detector", "rounds_asked", "steps", "seed", "options")


def of_what_teaches(outputs: ArtifactReader, labels: Sequence[Labels], area: Area) -> Row:
    """The figures of the rounds and of the fits that teach; those of what was taught are left open."""
    of_all, split, instants = outputs.read(FITS), outputs.read(SPLIT), outputs.read(ANNOTATIONS)
    fits = of_fits(labels, area, of_all)
    may_teach = of_what_may_teach(labels, area, of_all, instants, split)
    rounds = outputs.read(ROUNDS)
    return {
        "round": rounds.kept,
        **dict.fromkeys(("recall", "precision", "bev_iou", "ate_m", "aoe_deg")),
        "fits": {name: figures(of) for name, of in parts(fits, split).items()},
        "may_teach": figures([judged for _, judged in may_teach]),
        "found": counts_in_area(instants, area),
        "rounds": rounds.model_dump(),
    }


def of_what_was_taught(outputs: ArtifactReader, labels: Sequence[Labels], area: Area, min_score: float) -> Row:
    """The figures of the fine-tuned network: of the tracks of all cameras, and of single images."""
    split, rig = outputs.read(SPLIT), outputs.read(RIG)
    tracks = {name: figures(of) for name, of in parts(of_tracks(labels, area, outputs.read(TRACKS)), split).items()}
    instants = outputs.read(FRAMES).frame_sets
    single = list(of_one_camera(labels, area, rig, instants, detector_of(outputs, min_score)))
    cameras = {camera: figures([one for _, of, one in single if of == camera]) for camera in rig}
    every = tracks["all"]
    consistency = outputs.read(METRICS).self_consistency
    return {
        **{name: every[name] for name in ("recall", "precision", "bev_iou", "ate_m", "aoe_deg")},
        "tracks": tracks,
        "one_camera_m": ONE_CAMERA_M,
        "one_camera": {"all": figures([one for _, _, one in single]), **cameras},
        "held_out": {name: consistency[name].model_dump() for name in ("baseline", "finetuned")},
    }


def run(arguments: argparse.Namespace, seed: int) -> ArtifactReader:
    """The outputs of the pipeline with a seed; what is in the folder of runs is not made again."""
    folder = SiteFolder.load(arguments.site)
    options: dict[str, dict[str, Any]] = {}
    if arguments.detector_file is not None:
        folder = replace(folder, assets={**folder.assets, "detector": arguments.detector_file})
        options["detect"] = {"detector": "custom"}
    # labels in the site would only be evaluated by another benchmark's rules
    folder = replace(folder, assets={name: path for name, path in folder.assets.items() if name != "labels"})
    asked = parse_options(arguments.set)
    for stage, values in {"finetune": {"seed": seed}, "rounds": {"seed": seed}}.items():
        options[stage] = {**options.get(stage, {}), **values}
    for stage, values in asked.items():
        options[stage] = {**options.get(stage, {}), **values}
    store = StageStore(arguments.runs)
    if arguments.measure_only:
        return latest(folder, store)
    return run_pipeline(
        folder, store, PipelineConfig.parse(options), _said, until="lift" if arguments.fits_only else "track"
    ).outputs


def _said(update: StageUpdate) -> None:
    if update.state != "running":
        print(f"{update.state:>10} {update.seconds:7.1f} s  {update.stage}", flush=True)


def written(path: Path, row: Mapping[str, Any]) -> list[Row]:
    """All rows of a file, with this one in place of another of the same run."""
    rows = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []
    rows = [other for other in rows if any(other.get(name) != row.get(name) for name in _KEY)] + [dict(row)]
    rows.sort(key=lambda one: tuple(str(one.get(name)) for name in _KEY))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", type=Path, help="a site folder")
    parser.add_argument("--labels", type=Path, required=True, help="JSON, see benchmarks.real_labels.read_labels")
    parser.add_argument(
        "--area", type=Path, required=True, help="JSON: polygon_m, within which all is labelled; ignore"
    )
    parser.add_argument("--runs", type=Path, default=Path("build/real"), help="outputs of stages are kept there")
    parser.add_argument("--version", default="unreleased", help="of the code, as rows call it")
    parser.add_argument("--detector", default="bundled", help="what rows call it")
    parser.add_argument("--detector-file", type=Path, help="ONNX; without, the bundled one")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--set", nargs="*", default=[], metavar="OPTION=VALUE", help="options of the pipeline")
    parser.add_argument("--fits-only", action="store_true", help="nothing is fine-tuned: only what would teach")
    parser.add_argument("--measure-only", action="store_true", help="of the last run in the folder, whatever it was")
    parser.add_argument("--out", type=Path, default=Path("build/real"))
    arguments = parser.parse_args()
    area, ignored = read_area(arguments.area)
    labels = read_labels(arguments.labels, ignored)
    steps = parse_options(arguments.set).get("finetune", {}).get("steps", PipelineConfig().finetune.steps)
    rows: list[Row] = []
    for seed in arguments.seeds:
        outputs = run(arguments, seed)
        config = PipelineConfig.parse(parse_options(arguments.set))
        row = {
            "site": arguments.site.resolve().name,
            "version": arguments.version,
            "detector": arguments.detector,
            "rounds_asked": config.rounds.most,
            "steps": 0 if arguments.fits_only else steps,
            "seed": seed,
            "options": arguments.set,
            **of_what_teaches(outputs, labels, area),
        }
        if not arguments.fits_only:
            row |= of_what_was_taught(outputs, labels, area, config.track.min_score)
        rows = written(arguments.out / "real-sites.json", row)
        for name in [name for name in ("fits", "tracks", "one_camera") if name in row]:
            of = row[name]["all"]
            print(
                name, {key: of[key] for key in ("asked", "found", "false", "ate_m", "aoe_deg", "bev_iou")}, flush=True
            )
        if not arguments.fits_only:
            save(birds_eye(labels, area, outputs.read(TRACKS), outputs.read(RIG)), arguments.out / "real-sites.png")
    (arguments.out / "real-sites.md").write_text(document(rows), encoding="utf-8")
    print(document(rows))


if __name__ == "__main__":
    main()
