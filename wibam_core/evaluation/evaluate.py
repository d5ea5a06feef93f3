"""Detections of all frames against labels."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wibam_core.config import EvaluateConfig
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.evaluation.matching import match_in_image, match_on_ground, paper_filter
from wibam_core.evaluation.metrics import MatchMetrics, alias_share, box_errors, compare, compare_as_published
from wibam_core.geometry.box3d import XY, Z
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.polygons import inside_any
from wibam_core.road_users import CLASSES, RoadUserClass, may_be_one
from wibam_core.scene import LabelledInstant, Vehicles3D

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mode = Literal["correct", "paper_compat"]

#: More than an instant ever has.
_MOST_LABELS = 1_000_000


@dataclass(frozen=True, eq=False)
class Sightings:
    """Labelled vehicles as single cameras saw them.

    Attributes:
        vehicle_ids: (K,); a label without an id has a negative one of its own, the same for every detector.
        classes: (K,) true ones, indices into `CLASSES`.
        visibility: (K,) in that camera. distance_m: (K,) from that camera over the ground.
        elevation_deg: (K,) angle between the ground and the ray from that camera to the vehicle.
    """

    vehicle_ids: Indices
    classes: Indices
    visibility: Array
    distance_m: Array
    elevation_deg: Array


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What one detector got right and wrong.

    Attributes:
        metrics, matched, errors, sd: of matched pairs, in the same order. errors: (K, 7) predicted less true box, the
            yaw in (−π, π]. sd: (K, 7) standard deviations that the detector states; NaN where it states none.
        missed: labels that count and were not found. Always empty as published.
        false_positives: detections of nothing. 0 as published.
        alias_share: share of matches whose yaw is off by 150° or more.
        frames: frames with labels.
    """

    mode: Mode
    metrics: MatchMetrics
    errors: Array
    sd: Array
    matched: Sightings
    missed: Sightings
    false_positives: int
    alias_share: float
    frames: int


def evaluate(
    predictions: Iterable[Vehicles3D],
    labels: LabelTimeline,
    rig: Mapping[str, Camera],
    config: EvaluateConfig,
    mode: Mode = "correct",
    classes: Collection[RoadUserClass] = CLASSES,
) -> Evaluation:
    """Compare detections with labels, each frame at its own time.

    Args:
        predictions: one entry per frame, empty ones included: ``camera_id`` says whose, and ``time_ns`` is the time
            that the frame was exposed. Frames without labels are left out.
        labels: by time.
        rig: camera id -> camera.
        config: which labels count and how near a match is; ``paper_compat`` uses its own published rules.
        mode: see `match_on_ground` and `match_in_image`.
        classes: what the network knows; labels of others are no concern of its.
    """
    numbers = np.array([road_user.number for road_user in classes], dtype=np.int64)
    labelled = (
        (found, _of_classes(instant, numbers))
        for found in predictions
        if (instant := labels.at(found.time_ns)) is not None
    )
    frames = [
        _compare_frame(number, found, instant, rig[str(found.camera_id)], config, mode)
        for number, (found, instant) in enumerate(labelled)
    ]
    predicted = np.concatenate([np.empty((0, 7)), *(frame.predicted for frame in frames)])
    truth = np.concatenate([np.empty((0, 7)), *(frame.truth for frame in frames)])
    return Evaluation(
        mode=mode,
        metrics=compare(predicted, truth) if mode == "correct" else compare_as_published(predicted, truth),
        errors=box_errors(predicted, truth),
        sd=np.concatenate([np.empty((0, 7)), *(frame.sd for frame in frames)]),
        matched=_join([frame.matched for frame in frames]),
        missed=_join([frame.missed for frame in frames]),
        false_positives=sum(frame.false_positives for frame in frames),
        alias_share=alias_share(predicted, truth),
        frames=len(frames),
    )


@dataclass(frozen=True, eq=False)
class _Frame:
    predicted: Array
    sd: Array
    truth: Array
    matched: Sightings
    missed: Sightings
    false_positives: int


def _compare_frame(
    number: int, found: Vehicles3D, instant: LabelledInstant, camera: Camera, config: EvaluateConfig, mode: Mode
) -> _Frame:
    labels = instant.vehicles
    visibility = np.asarray(instant.visibility.get(str(found.camera_id), np.zeros(len(labels))), dtype=np.float64)
    distance = np.linalg.norm(labels.boxes[:, XY] - camera.centre_m[:2], axis=1)
    elevation = np.degrees(np.arctan2(camera.centre_m[2] - labels.boxes[:, Z], distance))
    cared_for = ~inside_any(labels.boxes[:, XY], instant.do_not_care)
    if mode == "paper_compat":
        found = found.where(paper_filter(found.boxes, found.scores))
        match = match_in_image(labels.boxes, (visibility > 0) & cared_for, found.boxes, camera)
    else:
        found = found.where(found.scores >= config.min_score)
        in_range = np.linalg.norm(found.boxes[:, XY] - camera.centre_m[:2], axis=1) <= config.max_range_m
        counts = (visibility > config.min_visibility) & (distance <= config.max_range_m) & cared_for
        match = match_on_ground(
            labels.boxes, counts, found.boxes, config.match_distance_m, may_be_one(labels.classes, found.classes)
        )
        in_question = in_range & ~inside_any(found.boxes[:, XY], instant.do_not_care)
        false_positives = match.false_positives[in_question[match.false_positives]]
        match = replace(match, false_positives=false_positives)
    unnamed = -1 - (number * _MOST_LABELS + np.arange(len(labels)))
    ids = np.where(labels.ids < 0, unnamed, labels.ids)
    sightings = Sightings(ids, labels.classes, visibility, distance, elevation)
    return _Frame(
        found.boxes[match.detections],
        found.sd[match.detections],
        labels.boxes[match.labels],
        _take(sightings, match.labels),
        _take(sightings, match.missed),
        len(match.false_positives),
    )


def _of_classes(instant: LabelledInstant, numbers: Indices) -> LabelledInstant:
    """What is labelled of these classes."""
    own = np.isin(instant.vehicles.classes, numbers)
    visibility = {camera_id: np.asarray(seen)[own] for camera_id, seen in instant.visibility.items()}
    return LabelledInstant(instant.vehicles.where(own), visibility, do_not_care=instant.do_not_care)


def _take(sightings: Sightings, rows: Indices) -> Sightings:
    return Sightings(**{name: values[rows] for name, values in vars(sightings).items()})


def _join(parts: list[Sightings]) -> Sightings:
    none = np.empty(0)
    nobody = Sightings(none.astype(np.int64), none.astype(np.int64), none, none, none)
    return Sightings(
        **{name: np.concatenate([getattr(part, name) for part in (nobody, *parts)]) for name in vars(nobody)}
    )
