"""What fine-tuning gains, and how: methods side by side on simulated sites that were never used to choose anything.

Rows per site and seed:

- ``baseline``: the bundled network, placed by the ground plane, and ``baseline_depth``: by its own depth.
- ``paper``: fine-tuned with the published loss (Howe et al. 2021, eq. 1).
- ``lifted``: fine-tuned on the fits to all views, the default.
- ``truth``: the same training on the true boxes of the same vehicles: what better labels could give.
- ``labels``: the fits themselves, in the training part.

Each network is measured on all frames of the held-out part of its site, as a job measures it. Writes ``learning.json``
(rows) and ``learning.md`` (means over sites and seeds).

Run: python benchmarks/learning.py --sites 501 502 --seeds 0 --seconds 90 --steps 350 --out docs
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wibam_core.config import EvaluateConfig, FinetuneConfig, PipelineConfig
from wibam_core.dataset.split import Split
from wibam_core.evaluation.evaluate import evaluate
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.evaluation.matching import assign, match_on_ground
from wibam_core.evaluation.metrics import METRICS, compare
from wibam_core.evaluation.summary import mean_sd, summarise
from wibam_core.formats.annotations import read_annotations
from wibam_core.formats.framestore import FrameStore
from wibam_core.formats.labels import read_labels
from wibam_core.formats.rig import read_rig
from wibam_core.formats.vehicles3d import read_vehicles3d
from wibam_core.models.decode import Decode
from wibam_core.models.inference import predict
from wibam_core.models.small import SmallNetwork
from wibam_core.models.stored_frames import stored_frames
from wibam_core.models.weights import bundled, load_network
from wibam_core.progress import silent
from wibam_core.scene import AnnotatedInstant, CameraRig, Vehicles3D
from wibam_core.stages.runner import SiteFolder, run_pipeline
from wibam_core.stages.store import StageStore
from wibam_core.synthetic.options import SimulationOptions
from wibam_core.synthetic.recorder import record_site
from wibam_core.training.dataset import site_views
from wibam_core.training.finetune import SiteDataset, finetune

METHODS = ("baseline_depth", "baseline", "paper", "lifted", "truth", "labels")
#: A true vehicle farther than this from a cluster of rays is another one, m.
_SAME_VEHICLE_M = 3.0

Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Site:
    """A recorded site after the stages before fine-tuning."""

    number: int
    folder: SiteFolder
    store: StageStore
    rig: CameraRig
    frames: FrameStore
    instants: list[AnnotatedInstant]
    lifts: list[Vehicles3D]
    split: Split
    labels: LabelTimeline

    @property
    def minutes(self) -> float:
        times = self.split.times_ns["train"]
        return (times[-1] - times[0]) * 1e-9 / 60


def make_site(number: int, seconds: float, density: float, cache: Path) -> Site:
    """Record, or take what was recorded before, and run the stages up to the fits."""
    folder = cache / f"site-{number}-{seconds:g}s-{density:g}"
    if not (folder / "site.json").is_file():
        options = SimulationOptions(seed=number, seconds=seconds, traffic_density=density, workers=2)
        record_site(folder, options)
    site, store = SiteFolder.load(folder), StageStore(folder / "outputs")
    done = run_pipeline(site, store, PipelineConfig(), until="lift").folders
    return Site(
        number,
        site,
        store,
        read_rig(done["calibrate"] / "rig.json"),
        FrameStore(done["frames"]),
        read_annotations(done["associate"] / "annotations.parquet"),
        read_vehicles3d(done["lift"] / "lifts.parquet"),
        Split.from_json(json.loads((done["dataset"] / "split.json").read_text())),
        LabelTimeline(read_labels(site.assets["labels"])),
    )


def rows_of(site: Site, seed: int, steps: int, methods: Sequence[str]) -> Iterator[Row]:
    """One row a method."""
    for method in methods:
        decode: Decode = "depth" if method == "baseline_depth" else "plane"
        about = {"site": site.number, "seed": seed, "method": method, "decode": decode, "minutes": site.minutes}
        if method == "labels":
            yield {**about, "steps": 0, **label_figures(site)}
            continue
        trained = not method.startswith("baseline")
        network = network_of(site, method, seed, steps)
        yield {**about, "steps": steps if trained else 0, **figures(site, network, decode)}


def network_of(site: Site, method: str, seed: int, steps: int) -> SmallNetwork:
    """The network of a method, trained where it is to be trained."""
    base = load_network(bundled("mono_small.safetensors"))
    if method.startswith("baseline"):
        return base
    options = {"steps": steps, "seed": seed, "method": "paper" if method == "paper" else "lifted"}
    if method != "truth":
        config = PipelineConfig.parse({"finetune": options})
        done = run_pipeline(site.folder, site.store, config, until="finetune")
        return load_network(done.folders["finetune"] / "weights.safetensors")
    with tempfile.TemporaryDirectory() as scratch:
        data = SiteDataset(site.frames, site.rig, *(views(site, part, true_lifts(site)) for part in ("train", "val")))
        return finetune(base, data, FinetuneConfig(**options), silent, Path(scratch)).network


def views(site: Site, part: str, lifts: Sequence[Vehicles3D]) -> list[Any]:
    """The labelled frames of a part of the split."""
    times = set(site.split.times_ns[part])
    chosen = [instant for instant in site.instants if instant.time_ns in times]
    return site_views(chosen, site.frames, lifts, site.rig, site.split.left_out_tracks[part])


def true_lifts(site: Site) -> list[Vehicles3D]:
    """The true boxes of the associated vehicles, with their track ids, where a fit would be."""
    found = []
    for instant in site.instants:
        labelled = site.labels.at(instant.time_ns)
        vehicles = [vehicle for vehicle in instant.vehicles if vehicle.track_id >= 0]
        if labelled is None or not vehicles or not len(labelled.vehicles):
            continue
        places = np.array([(vehicle.x_m, vehicle.y_m) for vehicle in vehicles])
        distance = np.linalg.norm(places[:, None] - labelled.vehicles.boxes[None, :, :2], axis=-1)
        rows, columns = assign(distance, _SAME_VEHICLE_M)
        ids = np.array([vehicles[row].track_id for row in rows], np.int64)
        truth = labelled.vehicles
        certain = np.full((len(rows), 7), 0.01)
        found.append(
            Vehicles3D.of(
                instant.time_ns, truth.boxes[columns], truth.classes[columns], ids, np.ones(len(ids)), certain
            )
        )
    return found


def figures(site: Site, network: SmallNetwork, decode: Decode) -> Row:
    """The metrics of a network on the test part of its site."""
    config = EvaluateConfig()
    times = set(site.split.times_ns["test"])
    instants = [instant for instant in site.frames.frame_sets if instant.time_ns in times]
    exposed = {(i.time_ns, camera): time for i in instants for camera, time in i.frame_times_ns.items()}
    found = predict(network, stored_frames(site.frames, instants, site.rig), decode=decode, min_score=config.min_score)
    at_exposure = [replace(v, time_ns=exposed[v.time_ns, str(v.camera_id)]) for v in found]
    return summarise(evaluate(at_exposure, site.labels, site.rig, config))


def label_figures(site: Site) -> Row:
    """The metrics of the fits in the training part, of those that are a true vehicle."""
    times = set(site.split.times_ns["train"])
    ours, theirs = [np.empty((0, 7))], [np.empty((0, 7))]
    for vehicles in site.lifts:
        labelled = site.labels.at(vehicles.time_ns)
        if vehicles.time_ns in times and labelled is not None:
            truth = labelled.vehicles.boxes
            match = match_on_ground(truth, np.ones(len(truth), bool), vehicles.boxes, EvaluateConfig().match_distance_m)
            ours.append(vehicles.boxes[match.detections])
            theirs.append(truth[match.labels])
    metrics = compare(np.concatenate(ours), np.concatenate(theirs))
    return {name: mean_sd(getattr(metrics, name)) for name in METRICS} | {"matched": sum(map(len, ours))}


def table(rows: Sequence[Row]) -> str:
    """Markdown: means over sites and seeds, and the standard deviation of those means."""
    shown = (*METRICS, "recall", "bev_iou_misses_zero")
    titles = ("BEV IoU", "3D IoU", "ATE m", "ASE", "AOE °", "recall", "BEV IoU, misses as 0")
    lines = [f"| method | decode | runs | {' | '.join(titles)} |", "|---" * (3 + len(titles)) + "|"]
    for method in METHODS:
        mine = [row for row in rows if row["method"] == method]
        if mine:
            cells = [_cell([row.get(name) for row in mine], 1 if name == "aoe_deg" else 3) for name in shown]
            lines.append(f"| {method} | {mine[0]['decode']} | {len(mine)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(values: Sequence[Mapping[str, float | None] | None], digits: int) -> str:
    means = [value["mean"] for value in values if value is not None and value["mean"] is not None]
    if not means:
        return "–"
    spread = f" ± {np.std(means, ddof=1):.{digits}f}" if len(means) > 1 else ""
    return f"{np.mean(means):.{digits}f}{spread}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, nargs="+", default=[501, 502])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--density", type=float, default=1.2)
    parser.add_argument("--steps", type=int, default=350)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--cache", type=Path, default=Path("build/learning"))
    parser.add_argument("--out", type=Path, default=Path("build/learning"))
    arguments = parser.parse_args()
    rows: list[Row] = []
    for number in arguments.sites:
        site = make_site(number, arguments.seconds, arguments.density, arguments.cache)
        for seed in arguments.seeds:
            for row in rows_of(site, seed, arguments.steps, arguments.methods):
                rows.append(row)
                print(f"site {number}, seed {seed}\n{table([row])}", flush=True)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "learning.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    command = f"python benchmarks/learning.py --sites {' '.join(map(str, arguments.sites))} --seeds "
    command += f"{' '.join(map(str, arguments.seeds))} --seconds {arguments.seconds:g} --steps {arguments.steps}"
    parts = ("# What fine-tuning gains", "Means of the runs ± their standard deviation.", f"    {command}", table(rows))
    text = "\n\n".join(parts) + "\n"
    (arguments.out / "learning.md").write_text(text, encoding="utf-8")
    print(table(rows))


if __name__ == "__main__":
    main()
