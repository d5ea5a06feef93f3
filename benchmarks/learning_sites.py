"""Simulated sites for the benchmarks of learning, networks trained on them, and how good those are."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.config import EvaluateConfig, FinetuneConfig, PipelineConfig
from wibam_core.documents.split import Split
from wibam_core.evaluation.evaluate import Evaluation, Mode, evaluate
from wibam_core.evaluation.instants import exposure_times
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.evaluation.matching import assign, match_on_ground
from wibam_core.evaluation.metrics import METRICS, compare
from wibam_core.evaluation.reliability import reliability
from wibam_core.evaluation.self_consistency import Agreement, agreements, roughness, self_consistency
from wibam_core.evaluation.significance import significance
from wibam_core.evaluation.summary import by_class, by_distance, by_elevation, mean_sd, summarise
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.formats.framestore import FrameStore
from wibam_core.formats.labels import read_labels
from wibam_core.geometry.box3d import XY, YAW
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.models.network import predict
from wibam_core.models.stored_frames import stored_frames
from wibam_core.models.weights import bundled
from wibam_core.networks.registry import load_network
from wibam_core.placing import Decode
from wibam_core.progress import silent
from wibam_core.scene import AnnotatedInstant, CameraRig, FrameSet, Vehicles3D
from wibam_core.stages.runner import SiteFolder, run_pipeline
from wibam_core.stages.store import StageStore
from wibam_core.synthetic.options import SimulationOptions
from wibam_core.synthetic.recorder import record_site
from wibam_core.training.calibration import sd_factors
from wibam_core.training.dataset import FRONT_SD_RAD, SiteView, site_views
from wibam_core.training.device import choose_device_to_detect
from wibam_core.training.finetune import SiteDataset, finetune
from wibam_core.training.trainable import TrainableNetwork

#: A true vehicle farther than this from a cluster of rays is another one, m.
_SAME_VEHICLE_M = 3.0
#: What is told of the true error of a vehicle; it needs so many boxes that other views were compared with.
OF_VEHICLE = ("bev_iou", "ate_m")
_MIN_SIGHTINGS = 4

Figures = dict[str, Any]
#: Instant, camera, row of a detection.
_Key = tuple[int, str, int]


@dataclass(frozen=True, eq=False)
class Trained:
    """A network, how its boxes are placed, and what its standard deviations are multiplied with."""

    network: TrainableNetwork
    decode: Decode
    factors: SdFactors


@dataclass(frozen=True, eq=False)
class Site:
    """A recorded site after the stages before fine-tuning.

    Attributes:
        number: seed of the simulation.
        stages: name -> published folder of the stages that were run.
        lifts: of the instants of the split.
        labels: the truth, by time.
    """

    number: int
    folder: SiteFolder
    store: StageStore
    outputs: ArtifactReader
    rig: CameraRig
    frames: FrameStore
    instants: list[AnnotatedInstant]
    lifts: list[Vehicles3D]
    split: Split
    labels: LabelTimeline

    @property
    def minutes(self) -> float:
        """Length of the training part."""
        times = self.split.times_ns["train"]
        return (times[-1] - times[0]) * 1e-9 / 60

    @property
    def start(self) -> Path:
        """The weights that fine-tuning starts from: the site's own, or else the bundled ones."""
        return self.folder.assets.get("network", bundled("mono_small.safetensors"))

    @property
    def usual_decode(self) -> Decode:
        """How boxes of a network that was fine-tuned here are placed, unless options say."""
        return FinetuneConfig(network="custom" if "network" in self.folder.assets else "small").decode

    @cached_property
    def test_frames(self) -> list[FrameSet]:
        times = set(self.split.times_ns["test"])
        return [instant for instant in self.frames.frame_sets if instant.time_ns in times]

    @cached_property
    def baseline(self) -> Evaluation:
        """Of the network before training, placed as after it, on the test part."""
        return evaluation(self, detections(self, untrained(self, self.usual_decode)))

    def of(self, part: str) -> list[AnnotatedInstant]:
        """The instants of a part of the split."""
        times = set(self.split.times_ns[part])
        return [instant for instant in self.instants if instant.time_ns in times]


def make_site(
    number: int, seconds: float, density: float, width_px: int, cache: Path, network: Path | None = None
) -> Site:
    """Record, or take what was recorded before, and run the stages up to the fits.

    Args:
        number: of the site, the seed of its simulation.
        seconds: length of the recording.
        density: of the traffic.
        width_px: of the images, which are 16:9.
        cache: where recordings and the stages' outputs are kept.
        network: what fine-tuning starts from instead of the bundled network, as `wibam weights convert` writes it.
    """
    folder = cache / f"site-{number}-{seconds:g}s-{density:g}-{width_px}"
    if not (folder / "site.json").is_file():
        size = {"width_px": width_px, "height_px": width_px * 9 // 16}
        record_site(folder, SimulationOptions(seed=number, seconds=seconds, traffic_density=density, workers=2, **size))
    site, store = SiteFolder.load(folder), StageStore(folder / "outputs")
    if network is not None:
        site = replace(site, assets={**site.assets, "network": network})
    return site_of(number, site, store, run_pipeline(site, store, PipelineConfig(), until="lift").outputs)


def site_of(number: int, folder: SiteFolder, store: StageStore, outputs: ArtifactReader) -> Site:
    """Read what the stages up to the fits wrote."""
    return Site(
        number,
        folder,
        store,
        outputs,
        outputs.read(catalogue.RIG),
        outputs.read(catalogue.FRAMES),
        outputs.read(catalogue.ANNOTATIONS),
        outputs.read(catalogue.FITS),
        outputs.read(catalogue.SPLIT),
        LabelTimeline(read_labels(folder.assets["labels"])),
    )


def fitted_by(site: Site, options: Mapping[str, Any]) -> Site:
    """The site with fits made by these options of the stage that makes them."""
    config = PipelineConfig.parse({"lift": dict(options)})
    outputs = run_pipeline(site.folder, site.store, config, until="lift").outputs
    return site_of(site.number, site.folder, site.store, outputs)


def untrained(site: Site, decode: Decode) -> Trained:
    """What fine-tuning starts from."""
    return Trained(load_network(site.start), decode, SdFactors())


def finetuned_by_stage(site: Site, options: Mapping[str, Any], lift: Mapping[str, Any] | None = None) -> Trained:
    """Fine-tuned as a job with these options does it; taken from the store where that was done before."""
    config = PipelineConfig.parse({"finetune": dict(options), "lift": dict(lift or {})})
    done = run_pipeline(site.folder, site.store, config, until="finetune").outputs
    network = load_network(done.read(catalogue.WEIGHTS))
    return Trained(network, network.card.decode, SdFactors(**network.card.sd_factors))


def placed(site: Site, trained: Trained, decode: Decode) -> Trained:
    """The same network with its boxes placed otherwise, and its standard deviations calibrated to that."""
    data = SiteDataset(site.frames, site.rig, *(views(site, part, site.lifts) for part in ("train", "val")))
    return Trained(trained.network, decode, sd_factors(trained.network, data, decode))


def finetuned_on(
    site: Site, train: Sequence[SiteView], validation: Sequence[SiteView], config: FinetuneConfig
) -> Trained:
    """Fine-tuned on other views or labels than a job would take."""
    data = SiteDataset(site.frames, site.rig, train, validation)
    with tempfile.TemporaryDirectory() as scratch:
        network = finetune(load_network(site.start), data, config, silent, Path(scratch)).network
    return Trained(network, config.decode, sd_factors(network, data, config.decode))


def views(site: Site, part: str, lifts: Sequence[Vehicles3D], *, complete: bool = True) -> list[SiteView]:
    """The frames of a part of the split, labelled with ``lifts``; ``complete``: as `site_views`."""
    left_out = site.split.left_out_tracks[part]
    return site_views(site.of(part), site.frames, lifts, site.rig, left_out, complete=complete)


def true_lifts(site: Site) -> list[Vehicles3D]:
    """The true boxes of the associated vehicles, with their track ids, where a fit would be."""
    found = []
    for instant in site.instants:
        labelled = site.labels.at(instant.time_ns)
        vehicles = [vehicle for vehicle in instant.vehicles if vehicle.track_id >= 0]
        if labelled is None or not vehicles or not len(labelled.vehicles):
            continue
        places = np.array([(vehicle.x_m, vehicle.y_m) for vehicle in vehicles])
        distance = np.linalg.norm(places[:, None] - labelled.vehicles.boxes[None, :, XY], axis=-1)
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


def detections(site: Site, trained: Trained) -> list[Vehicles3D]:
    """Of all frames of the test part; times are the instants."""
    frames = stored_frames(site.frames, site.test_frames, site.rig)
    min_score = EvaluateConfig().min_score
    network = trained.network.runnable(choose_device_to_detect("auto"))
    found = predict(network, frames, decode=trained.decode, min_score=min_score)
    return [trained.factors.apply(vehicles) for vehicles in found]


def evaluation(site: Site, found: Sequence[Vehicles3D], mode: Mode = "correct") -> Evaluation:
    """Detections of the test part against the truth, each frame at its own time of exposure."""
    exposed = exposure_times(site.test_frames)
    at_exposure = [replace(v, time_ns=exposed[v.time_ns, str(v.camera_id)]) for v in found]
    return evaluate(at_exposure, site.labels, site.rig, EvaluateConfig(), mode)


def figures(site: Site, trained: Trained) -> Figures:
    """All that a row says of a network: metrics, parts, significance against the baseline, consistency, reliability."""
    found = detections(site, trained)
    correct, published = evaluation(site, found), evaluation(site, found, "paper_compat")
    kinds = reliability(correct.errors, correct.sd)
    return {
        **summarise(correct).model_dump(),
        "paper_compat": summarise(published).model_dump(include=set(METRICS)),
        "by_distance": [part.model_dump() for part in by_distance(correct)],
        "by_elevation": [part.model_dump() for part in by_elevation(correct)],
        "by_class": [part.model_dump(by_alias=True) for part in by_class(correct)],
        "significance": {name: test.model_dump() for name, test in significance(site.baseline, correct).items()},
        "consistency": consistency(site, found),
        "sd_factors": vars(trained.factors),
        "reliability": {
            kind: of.model_dump(include={"scale_factor", "calibration_error"}) for kind, of in kinds.items()
        },
    }


def label_figures(site: Site) -> Figures:
    """The metrics of the fits in the training part, of those that are a true vehicle.

    A heading that does not tell front from rear counts by its axis alone, as it is taught.
    """
    times = set(site.split.times_ns["train"])
    ours, theirs = [np.empty((0, 7))], [np.empty((0, 7))]
    for vehicles in site.lifts:
        labelled = site.labels.at(vehicles.time_ns)
        if vehicles.time_ns in times and labelled is not None:
            truth = labelled.vehicles.boxes
            match = match_on_ground(truth, np.ones(len(truth), bool), vehicles.boxes, EvaluateConfig().match_distance_m)
            fits, boxes = vehicles.boxes[match.detections].copy(), truth[match.labels]
            off = np.abs(normalise_angle(fits[:, YAW] - boxes[:, YAW])) > np.pi / 2
            fits[off & (vehicles.sd[match.detections, YAW] > FRONT_SD_RAD), YAW] += np.pi
            ours.append(fits)
            theirs.append(boxes)
    metrics = compare(np.concatenate(ours), np.concatenate(theirs))
    return {name: mean_sd(getattr(metrics, name)).model_dump() for name in METRICS} | {"matched": sum(map(len, ours))}


def consistency(site: Site, found: Sequence[Vehicles3D]) -> Figures:
    """What needs no label, of all detections, and beside the truth of every vehicle."""
    measured = self_consistency(found, site.of("test"), site.rig)
    return {**measured.model_dump(include={"other_views", "roughness_m"}), "vehicles": _of_vehicles(site, found)}


def _of_vehicles(site: Site, found: Sequence[Vehicles3D]) -> list[dict[str, float]]:
    """Of every vehicle with enough boxes: means over its boxes in all views."""
    truth = _true_figures(site, found)
    tracks: dict[int, list[Agreement]] = {}
    for one in agreements(found, site.of("test"), site.rig)[0]:
        if one.track_id >= 0 and (one.time_ns, one.camera_id, one.row) in truth:
            tracks.setdefault(one.track_id, []).append(one)
    result = []
    for track_id, boxes in tracks.items():
        rough = roughness(boxes)
        if len(boxes) < _MIN_SIGHTINGS or not len(rough):
            continue
        true = np.array([truth[one.time_ns, one.camera_id, one.row] for one in boxes])
        others = [iou for one in boxes for iou in one.other_ious]
        result.append(
            {
                "track": track_id,
                "boxes": len(boxes),
                "other_views": float(np.mean(others)),
                "roughness_m": float(rough.mean()),
                **dict(zip(OF_VEHICLE, true.mean(axis=0).tolist(), strict=True)),
            }
        )
    return result


def _true_figures(site: Site, found: Sequence[Vehicles3D]) -> dict[_Key, tuple[float, float]]:
    """(instant, camera, row) -> BEV IoU and ATE of every detection that is a true vehicle."""
    exposed = exposure_times(site.test_frames)
    result: dict[_Key, tuple[float, float]] = {}
    for vehicles in found:
        camera_id = str(vehicles.camera_id)
        labelled = site.labels.at(exposed[vehicles.time_ns, camera_id])
        if labelled is None:
            continue
        truth = labelled.vehicles.boxes
        match = match_on_ground(truth, np.ones(len(truth), bool), vehicles.boxes, EvaluateConfig().match_distance_m)
        metrics = compare(vehicles.boxes[match.detections], truth[match.labels])
        for number, detection in enumerate(match.detections.tolist()):
            key = (vehicles.time_ns, camera_id, detection)
            result[key] = (float(metrics.bev_iou[number]), float(metrics.ate_m[number]))
    return result
