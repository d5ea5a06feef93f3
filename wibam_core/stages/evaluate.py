"""Baseline and fine-tuned detector against labels, where there are any, and against the other views always."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from wibam_core.artifacts.catalogue import (
    ANNOTATIONS,
    FRAMES,
    METRICS,
    PREDICTIONS,
    PREDICTIONS_BASELINE,
    PREDICTIONS_FINETUNED,
    RIG,
    SPLIT,
    WEIGHTS,
)
from wibam_core.config import EvaluateConfig
from wibam_core.documents.metrics import DetectorFigures, LabelledInstants, Metrics, Reliability
from wibam_core.errors import TooFewInstants
from wibam_core.evaluation.evaluate import Evaluation, evaluate
from wibam_core.evaluation.instants import evaluated_instants, exposure_times
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.evaluation.labels_of_views import labels_of_views
from wibam_core.evaluation.reliability import reliability
from wibam_core.evaluation.self_consistency import self_consistency
from wibam_core.evaluation.significance import significance
from wibam_core.evaluation.summary import by_class, by_distance, by_elevation, by_visibility, summarise
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.formats.framestore import FrameStore
from wibam_core.formats.labels import read_labels
from wibam_core.models.network import Network
from wibam_core.models.stored_frames import stored_frames
from wibam_core.models.weights import bundled
from wibam_core.networks.registry import family_of, load_network, load_to_detect
from wibam_core.placing import Decode
from wibam_core.progress import Progress, part
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import CameraRig, FrameSet, Vehicles3D
from wibam_core.stages.base import StageContext, Summary
from wibam_core.stages.predict import predictions
from wibam_core.training.device import choose_device_to_detect

#: Figures of parts of the labelled vehicles, by their names in the metrics.
_BREAKDOWNS = {
    "by_visibility": by_visibility,
    "by_distance": by_distance,
    "by_elevation": by_elevation,
    "by_class": by_class,
}
#: How the published method places the boxes of the network before fine-tuning; beside as the fine-tuned one's are.
_PUBLISHED: tuple[Decode, ...] = ("plane", "depth")


def run(context: StageContext, config: EvaluateConfig) -> Summary:
    """Write `METRICS`, `PREDICTIONS_BASELINE` and `PREDICTIONS_FINETUNED`.

    All frames of the test part are used, and of labelled instants between those. Their times in the files are the
    instants; the evaluators compare each frame at its own time of exposure.

    Raises:
        TooFewInstants: the test part holds no instant with a frame.
        InvalidLabels: the labels cannot be read.
    """
    rig, store = context.read(RIG), context.read(FRAMES)
    labels = None
    if "labels" in context.assets:
        labels = LabelTimeline(labels_of_views(read_labels(context.assets["labels"]), rig))
    instants = _test_instants(context, store, labels)
    min_score = min(config.kept_score, config.min_score)
    tuned = load_network(context.read(WEIGHTS))
    card, factors = tuned.card, SdFactors(**tuned.card.sd_factors)
    start = context.assets["network"] if card.start == "custom" else bundled("mono_small.safetensors")
    device = choose_device_to_detect(card.device or "auto")
    baseline = load_to_detect(start, device, card.input_width_px)  # the same images for both
    decodes = family_of(card.family).decodes
    published = {f"baseline_{way}": way for way in _PUBLISHED if way != card.decode and way in decodes}
    ways = {"baseline": card.decode, **published}
    finetuned = _finetuned(context, store, instants, rig, min_score, part(context.progress, 0.0, 0.2))
    before = _detect(baseline, ways, store, instants, rig, min_score, part(context.progress, 0.2, 1.0))
    found = {**before, "finetuned": finetuned}
    context.write(PREDICTIONS_BASELINE, found["baseline"])
    context.write(PREDICTIONS_FINETUNED, found["finetuned"])
    metrics = _metrics(context, config, instants, found, labels, factors, baseline.known & tuned.known)
    context.write(METRICS, metrics)
    headlines = {"baseline": metrics.baseline, "finetuned": metrics.finetuned}
    return {
        "labels": metrics.labels,
        "instants": len(instants),
        **{name: _headline(figures) for name, figures in headlines.items() if figures is not None},
        "self_consistency": {name: of.other_views.model_dump() for name, of in metrics.self_consistency.items()},
    }


def _test_instants(context: StageContext, store: FrameStore, labels: LabelTimeline | None) -> list[FrameSet]:
    instants = evaluated_instants(store.frame_sets, context.read(SPLIT).times_ns["test"], labels)
    if not instants:
        raise TooFewInstants("the test part of the split holds no instant with a frame")
    return instants


def _finetuned(
    context: StageContext,
    store: FrameStore,
    instants: Sequence[FrameSet],
    rig: CameraRig,
    min_score: float,
    progress: Progress,
) -> list[Vehicles3D]:
    """What the fine-tuned network found, one `Vehicles3D` per frame, in order of time, then of the rig.

    Labelled instants that were not searched before are searched here: what is labelled changes nothing for tracking.
    """
    there = dict(context.read(PREDICTIONS).at([instant.time_ns for instant in instants]))
    missing = [instant for instant in instants if instant.time_ns not in there]
    if missing:
        network = load_to_detect(context.read(WEIGHTS))
        for number, found in enumerate(predictions(network, store, missing, rig, min_score), 1):
            there.setdefault(found.time_ns, {})[str(found.camera_id)] = found
            progress(number / (len(missing) * len(rig)), "Detecting: labelled instants")
    of_views = (there.get(instant.time_ns, {}) for instant in instants)
    return _above([found[camera_id] for found in of_views for camera_id in rig if camera_id in found], min_score)


def _detect(
    network: Network,
    ways: Mapping[str, Decode],
    store: FrameStore,
    instants: Sequence[FrameSet],
    rig: CameraRig,
    min_score: float,
    progress: Progress,
) -> dict[str, list[Vehicles3D]]:
    """Name of a way to place boxes -> what the network finds, placed so, one `Vehicles3D` per frame."""
    frames = stored_frames(store, instants, rig)
    total = sum(len(rig.keys() & instant.frame_times_ns.keys()) for instant in instants)
    detected = network.predict_each(frames, decodes=tuple(ways.values()), min_score=min_score)
    found: dict[str, list[Vehicles3D]] = {name: [] for name in ways}
    for number, placed in enumerate(detected, 1):
        for of_way, vehicles in zip(found.values(), placed, strict=True):
            of_way.append(vehicles)
        progress(number / total, f"Detecting: {next(iter(found))}")
    return found


def _metrics(
    context: StageContext,
    config: EvaluateConfig,
    instants: Sequence[FrameSet],
    predictions: dict[str, list[Vehicles3D]],
    labels: LabelTimeline | None,
    factors: SdFactors,
    known: Collection[RoadUserClass],
) -> Metrics:
    rig = context.read(RIG)
    times = {instant.time_ns for instant in instants}
    annotations = [instant for instant in context.read(ANNOTATIONS) if instant.time_ns in times]
    consistency = {
        name: self_consistency(_above(found, config.min_score), annotations, rig, known)
        for name, found in predictions.items()
    }
    labelled: dict[str, Any] = {}
    evaluations = _evaluations(config, rig, instants, predictions, labels, known)
    if evaluations is not None:
        correct, published = evaluations
        labelled = {
            **{name: summarise(evaluation) for name, evaluation in correct.items()},
            "paper_compat": {name: summarise(evaluation) for name, evaluation in published.items()},
            "significance": significance(correct["baseline"], correct["finetuned"]),
            **{by: {name: parts(one) for name, one in correct.items()} for by, parts in _BREAKDOWNS.items()},
            "reliability": _reliability(correct, factors),
        }
    return Metrics(
        options=config.model_dump(),
        labels="none" if evaluations is None else "hand",
        labelled_instants=_labelled_instants(labels, instants),
        not_asked_for=[str(kind) for kind in CLASSES if kind not in known],
        instants=len(instants),
        frames=len(next(iter(predictions.values()))),
        sd_factors=asdict(factors),
        self_consistency=consistency,
        **labelled,
    )


def _evaluations(
    config: EvaluateConfig,
    rig: CameraRig,
    instants: Sequence[FrameSet],
    predictions: dict[str, list[Vehicles3D]],
    labels: LabelTimeline | None,
    known: Collection[RoadUserClass],
) -> tuple[dict[str, Evaluation], dict[str, Evaluation]] | None:
    """Correct and as published, by method; None where no frame of the test part is labelled."""
    if labels is None:
        return None
    exposed = exposure_times(instants)
    correct, published = {}, {}
    for name, found in predictions.items():
        at_exposure = [replace(v, time_ns=exposed[v.time_ns, str(v.camera_id)]) for v in found]
        correct[name] = evaluate(at_exposure, labels, rig, config, classes=known)
        published[name] = evaluate(at_exposure, labels, rig, config, "paper_compat", known)
    return (correct, published) if next(iter(correct.values())).frames else None


def _reliability(evaluations: dict[str, Evaluation], factors: SdFactors) -> dict[str, dict[str, Reliability]]:
    """By method, and of the fine-tuned network also before its standard deviations were multiplied."""
    found = {name: reliability(evaluation.errors, evaluation.sd) for name, evaluation in evaluations.items()}
    finetuned = evaluations["finetuned"]
    return {**found, "finetuned_as_learned": reliability(finetuned.errors, finetuned.sd / factors.columns())}


def _labelled_instants(labels: LabelTimeline | None, instants: Sequence[FrameSet]) -> LabelledInstants:
    """How many instants the user labelled, how many lie in the test part (the others are not used), when that is."""
    first_ns, last_ns = instants[0].time_ns, instants[-1].time_ns
    return LabelledInstants(
        given=0 if labels is None else len(labels),
        in_test_part=0 if labels is None else labels.between(first_ns, last_ns),
        test_from_s=first_ns * 1e-9,
        test_to_s=last_ns * 1e-9,
    )


def _above(found: Sequence[Vehicles3D], min_score: float) -> list[Vehicles3D]:
    return [vehicles.where(vehicles.scores >= min_score) for vehicles in found]


def _headline(figures: DetectorFigures) -> dict[str, float | None]:
    names = ("bev_iou", "iou_3d", "ate_m", "ase", "aoe_deg", "recall")
    return {name: getattr(figures, name).mean for name in names}
