"""What the other stages made to `ReportData`: the only part of the report that reads files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

import wibam_core
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.association.rays import ground_points
from wibam_core.documents import base as documents
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.documents.conflicts import Conflicts
from wibam_core.documents.curves import Curves
from wibam_core.documents.metrics import Metrics
from wibam_core.documents.model_card import ModelCard
from wibam_core.documents.recordings import Probe
from wibam_core.documents.split import SUBSETS
from wibam_core.documents.statistics import LiftStatistics
from wibam_core.documents.synchronisation import Synchronisation as Changes
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.formats.framestore import FrameStore
from wibam_core.formats.labels import read_labels
from wibam_core.formats.model_card import read_card
from wibam_core.report.bev import BoxesInstant, ClusteredInstant
from wibam_core.report.charts import Bars, Curve, Delay, Histogram
from wibam_core.report.data import (
    Array,
    CalibrationRow,
    ClockRow,
    Dataset,
    Example,
    Recording,
    ReportData,
    StageRow,
    Synchronisation,
    Training,
)
from wibam_core.report.mosaic import typical_images
from wibam_core.report.selection import Choice, busiest, choose_examples
from wibam_core.scene import AnnotatedInstant, CameraRig, Vehicles3D

_CLUSTER_INSTANTS = 4
_METHODS = {
    "lifted": "lifted: boxes fitted to all views of each vehicle, then learned",
    "paper": "paper: the published multi-view reprojection loss (eq. 1)",
    "combined": "combined: boxes fitted to all views, and the published multi-view reprojection loss",
}
_DECODES = {
    "plane": "on the ground plane along the ray to their centres",
    "depth": "by the network's depth",
    "fused": "by the ground plane and the network's depth",
    "ground": "where their footprints are on the ground",
    "fitted": "where they agree best with all that the network says about them",
    "refined": "where they agree best with all that the network says about them and with a second look at their edges",
}
_KEPT = {"last": "those of the last step", "best": "those of the best validation loss"}

_ByFrame = Mapping[tuple[int, str], Vehicles3D]


def assemble(
    site_name: str, inputs: ArtifactReader, labels: Path | None, titles: Mapping[str, str], examples: int
) -> ReportData:
    """Read everything that a report shows.

    Args:
        site_name: as the user wrote it.
        inputs: what every stage but the report has made.
        labels: hand labels, where there are any.
        titles: stage -> what it does, for a person.
        examples: frames to show before and after.
    """
    rig, store = inputs.read(catalogue.RIG), inputs.read(catalogue.FRAMES)
    metrics, conflicts = inputs.read(catalogue.METRICS), inputs.read(catalogue.CONFLICTS)
    annotations, split = inputs.read(catalogue.ANNOTATIONS), inputs.read(catalogue.SPLIT)
    test = [instant for instant in annotations if instant.time_ns in set(split.times_ns["test"])]
    choices = choose_examples(test, tuple(rig), examples)
    before, after = inputs.read(catalogue.PREDICTIONS_BASELINE), inputs.read(catalogue.PREDICTIONS_FINETUNED)
    predictions = {
        name: _by_frame(found, metrics.options["min_score"])
        for name, found in (("baseline", before), ("finetuned", after))
    }
    tracks = inputs.read(catalogue.TRACKS)
    residuals = inputs.read(catalogue.RESIDUALS)
    made = {stage: inputs.manifest(stage) for stage in titles if stage in inputs.stages}
    timeline = LabelTimeline(read_labels(labels)) if labels is not None and metrics.finetuned is not None else None
    return ReportData(
        site_name=site_name,
        version=wibam_core.__version__,
        warnings=tuple(warning for stage in made for warning in made[stage].warnings),
        rig=rig,
        recordings=_recordings(inputs.read(catalogue.PROBE)),
        synchronisation=_synchronisation(inputs.read(catalogue.CHANGES)),
        calibration=_calibration(residuals),
        overlap=residuals.overlap,
        refinement=inputs.read(catalogue.REFINEMENT),
        dataset=_dataset(inputs),
        rounds=inputs.read(catalogue.ROUNDS),
        training=_training(
            inputs.read(catalogue.CURVES),
            read_card(inputs.read(catalogue.WEIGHTS)),
            inputs.read(catalogue.LIFT_STATISTICS),
        ),
        metrics=metrics,
        tracks=tuple(tracks),
        conflicts=tuple(conflicts.conflicts),
        conflict_thresholds=conflicts.thresholds,
        typical_images=typical_images(store, rig),
        exposure=conflicts.exposure,
        clusters=tuple(_clustered(instant, rig) for instant in busiest(annotations, _CLUSTER_INSTANTS)),
        boxes=tuple(_boxes(choice, predictions, timeline) for choice in choices),
        examples=tuple(_example(choice, store, rig, predictions, timeline) for choice in choices),
        stages=tuple(StageRow(titles[stage], one.hash, one.seconds) for stage, one in made.items()),
        options=_options(metrics, conflicts),
    )


def _by_frame(found: Sequence[Vehicles3D], min_score: float) -> _ByFrame:
    return {(v.time_ns, str(v.camera_id)): v.where(v.scores >= min_score) for v in found}


def _recordings(probe: Probe) -> tuple[Recording, ...]:
    return tuple(
        Recording(camera_id, info.codec, info.width_px, info.height_px, info.fps, info.duration_s)
        for camera_id, info in probe.cameras.items()
    )


def _synchronisation(changes: Changes) -> Synchronisation:
    if changes.method == "none":
        return Synchronisation((), (), measured=False)
    clocks = tuple(
        ClockRow(
            camera_id,
            clock.offset_s,
            clock.offset_sd_s,
            clock.drift_ppm,
            clock.drift_sd_ppm,
            clock.matched,
            clock.rms_before_s,
            clock.rms_after_s,
            clock.score,
            clock.ambiguous,
            clock.decided_by_traffic,
            clock.decided_by_sound,
        )
        for camera_id, clock in changes.cameras.items()
    )
    delays = tuple(
        Delay(seen.camera, group.time_s, seen.delay_before_s, seen.delay_after_s)
        for group in changes.groups
        for seen in group.observations
        if seen.camera != changes.reference and seen.delay_before_s is not None and seen.delay_after_s is not None
    )
    return Synchronisation(
        clocks,
        delays,
        candidates=tuple((id_, other) for id_, clock in changes.cameras.items() for other in clock.alternatives),
        pairs=tuple(changes.traffic),
        segments=tuple((id_, one) for id_, clock in changes.cameras.items() for one in clock.segments),
        sounds=tuple(changes.sound),
    )


def _calibration(residuals: CalibrationResiduals) -> tuple[CalibrationRow, ...]:
    return tuple(
        CalibrationRow(
            camera_id,
            one.kind,
            one.points,
            one.rejected,
            one.median_px,
            one.max_px,
            one.median_m,
            None if one.position_sd_m is None else float(np.linalg.norm(one.position_sd_m)),
            one.ground_sd_m,
            {(zone.from_m, zone.to_m): zone.m_per_px for zone in one.zones if zone.m_per_px is not None},
        )
        for camera_id, one in residuals.cameras.items()
    )


def _dataset(inputs: ArtifactReader) -> Dataset:
    associated = inputs.read(catalogue.ASSOCIATION_STATISTICS)
    statistics = inputs.read(catalogue.DATASET_STATISTICS)
    return Dataset(
        detected_boxes=inputs.read(catalogue.DETECTION_STATISTICS).boxes,
        unassociated_share=associated.unassociated_share,
        single_view=associated.single_view,
        subsets={name: statistics.subsets[name] for name in SUBSETS},
        plots=(
            Bars("vehicles by number of views", statistics.by_views),
            Bars("vehicles by class", statistics.by_class),
            _histogram("depth of the boxes", "distance along the optical axis (m)", statistics.depth_m),
            _histogram("elevation angle of the boxes", "angle below the horizontal (°)", statistics.elevation_deg),
            Bars("instants by number of vehicles", _by_number(statistics.vehicles_per_instant)),
            Bars("boxes by camera", statistics.boxes_by_camera),
        ),
    )


def _histogram(title: str, unit: str, counts: documents.Histogram) -> Histogram:
    return Histogram(title, unit, tuple(counts.edges), tuple(counts.counts))


def _by_number(counts: documents.Histogram) -> dict[str, int]:
    """A histogram of whole numbers in bins one wide."""
    return {f"{edge:.0f}": count for edge, count in zip(counts.edges, counts.counts, strict=False)}


def _training(curves: Curves, card: ModelCard, lifts: LiftStatistics) -> Training:
    steps = [epoch.step for epoch in curves.epochs]
    totals = (
        _curve("training", steps, [epoch.train for epoch in curves.epochs], "total"),
        _curve("validation", steps, [epoch.validation for epoch in curves.epochs], "total"),
    )
    names = dict.fromkeys(name for epoch in curves.epochs for name in epoch.train if name != "total")
    facts = [
        ("method", _METHODS.get(card.method or "", "none")),
        ("placing of boxes", _DECODES[card.decode]),
        ("steps", f"{curves.epochs[-1].step} in {len(curves.epochs)} epochs"),
        ("weights kept", f"{_KEPT.get(curves.kept, curves.kept)} (step {curves.kept_step})"),
        ("multi-view fits", f"{lifts.kept} of {lifts.fits} good enough to train on, of {lifts.tracks} vehicles"),
    ]
    if card.input_width_px is not None:
        facts.insert(2, ("images as the network sees them", f"{card.input_width_px} px wide"))
    if card.licence is not None:
        facts.append(("terms of the weights that it began with", card.licence))
    if lifts.residual is not None:
        facts.append(("median residual of the fits", f"{lifts.residual.p50:.3f} (mean 1 − GIoU over the views)"))
    parts = tuple(_curve(name.replace("_", " "), steps, [e.train for e in curves.epochs], name) for name in names)
    return Training(tuple(curve for curve in totals if curve.steps), parts, curves.kept_step, tuple(facts))


def _curve(title: str, steps: Sequence[int], losses: Sequence[Mapping[str, float]], name: str) -> Curve:
    """One part of the losses, over the epochs that have it."""
    known = [(step, loss[name]) for step, loss in zip(steps, losses, strict=True) if name in loss]
    return Curve(title, tuple(step for step, _ in known), tuple(value for _, value in known))


def _clustered(instant: AnnotatedInstant, rig: CameraRig) -> ClusteredInstant:
    cluster_of = {
        (camera_id, row): vehicle.obj_id for vehicle in instant.vehicles for camera_id, row in vehicle.views.items()
    }
    points, cameras, clusters = [np.empty((0, 2))], [], []
    for number, (camera_id, camera) in enumerate(rig.items()):
        if camera_id not in instant.detections:
            continue
        seen = instant.detections[camera_id]
        of_box = [cluster_of.get((camera_id, row), -1) for row in range(len(seen))]
        kept = [row for row, cluster in enumerate(of_box) if cluster >= 0]
        points.append(ground_points(camera, seen.whole_boxes, seen.classes)[kept])
        cameras += [number] * len(kept)
        clusters += [of_box[row] for row in kept]
    return ClusteredInstant(
        instant.time_ns / 1e9, np.concatenate(points), np.array(cameras, np.int64), np.array(clusters, np.int64)
    )


def _boxes(choice: Choice, predictions: Mapping[str, _ByFrame], timeline: LabelTimeline | None) -> BoxesInstant:
    time_ns = choice.instant.time_ns
    labelled = timeline.at(time_ns) if timeline is not None else None
    named = {"label": labelled.vehicles.boxes} if labelled is not None else {}
    for title, name in (("baseline", "baseline"), ("fine-tuned", "finetuned")):
        of_cameras = [found.boxes for (time, _), found in predictions[name].items() if time == time_ns]
        named[title] = np.concatenate([np.empty((0, 7)), *of_cameras])
    return BoxesInstant(time_ns / 1e9, named)


def _example(
    choice: Choice,
    store: FrameStore,
    rig: CameraRig,
    predictions: Mapping[str, _ByFrame],
    timeline: LabelTimeline | None,
) -> Example:
    time_ns, camera_id = choice.instant.time_ns, choice.camera_id
    views = [view for view in (camera_id, choice.other_id) if view is not None and store.has(view, time_ns)]
    labelled = timeline.at(time_ns) if timeline is not None else None
    return Example(
        time_s=time_ns / 1e9,
        camera_id=camera_id,
        other_id=views[1] if len(views) > 1 else None,
        cameras={view: rig[view] for view in views},
        images={view: store.image(view, time_ns) for view in views},
        baseline=_found(predictions["baseline"], time_ns, camera_id),
        finetuned=_found(predictions["finetuned"], time_ns, camera_id),
        labels=None if labelled is None else labelled.vehicles.boxes,
    )


def _found(predictions: _ByFrame, time_ns: int, camera_id: str) -> Array:
    found = predictions.get((time_ns, camera_id))
    return np.empty((0, 7)) if found is None else found.boxes


def _options(metrics: Metrics, conflicts: Conflicts) -> tuple[tuple[str, str], ...]:
    return tuple(
        (f"{stage}.{name}", f"{value:g}")
        for stage, options in (("evaluate", metrics.options), ("safety", conflicts.thresholds))
        for name, value in options.items()
    )
