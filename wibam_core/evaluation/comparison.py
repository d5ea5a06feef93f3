"""Two networks on the same held-out instants: which is better, and is that more than chance?"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wibam_core.config import EvaluateConfig
from wibam_core.documents.comparison import ComparedNetwork, NetworkComparison
from wibam_core.documents.metrics import Significance
from wibam_core.errors import Conflict
from wibam_core.evaluation.evaluate import evaluate
from wibam_core.evaluation.instants import exposure_times
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.evaluation.self_consistency import Agreement, agreements, self_consistency
from wibam_core.evaluation.significance import both_tests, significance
from wibam_core.evaluation.summary import summarise
from wibam_core.geometry.camera import Camera
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import AnnotatedInstant, FrameSet, Vehicles3D


def held_out_from_both(
    first: Sequence[FrameSet], second: Sequence[FrameSet], first_test: Collection[int], second_test: Collection[int]
) -> list[FrameSet]:
    """The instants of both test parts that are made of the same frames, in order of time.

    Args:
        first: all instants of the one job, in order of time.
        second: all of the other.
        first_test: times (ns) of the one's test part.
        second_test: times of the other's.

    Raises:
        Conflict: there are none.
    """
    wanted = set(first_test) & set(second_test)
    others = {one.time_ns: dict(one.local_times_ns) for one in second}
    common = [one for one in first if one.time_ns in wanted and others.get(one.time_ns) == dict(one.local_times_ns)]
    if not common:
        raise Conflict(
            "the two networks have no held-out instant in common",
            hint="Train both on the same recordings with the same clocks (sync) and parts (dataset).",
        )
    return common


def compare_networks(
    first: list[Vehicles3D],
    second: list[Vehicles3D],
    instants: Sequence[FrameSet],
    annotations: list[AnnotatedInstant],
    rig: Mapping[str, Camera],
    config: EvaluateConfig,
    labels: LabelTimeline | None = None,
    known: Collection[RoadUserClass] = CLASSES,
    cautions: Sequence[str] = (),
) -> NetworkComparison:
    """Judge both by the same instants, annotations, cameras, labels and classes.

    Args:
        first: what the one network found, one entry per camera and instant; others than ``instants`` are left out.
        second: what the other found.
        instants: see `held_out_from_both`.
        annotations: automatic multi-view vehicles, of those instants at least.
        rig: camera id -> camera.
        config: from which score on a box counts, and how labels are compared.
        labels: by hand, where there are any.
        known: what both networks know.
        cautions: what the caller knows to be unfair.
    """
    times = {instant.time_ns for instant in instants}
    of_instants = [one for one in annotations if one.time_ns in times]
    found = [
        [one.where(one.scores >= config.min_score) for one in of_one if one.time_ns in times]
        for of_one in (first, second)
    ]
    judged = [self_consistency(of_one, of_instants, rig, known) for of_one in found]
    agreed = [agreements(of_one, of_instants, rig, known)[0] for of_one in found]
    evaluations = None
    if labels is not None:
        exposed = exposure_times(instants)
        at_exposure = [
            [replace(one, time_ns=exposed[one.time_ns, str(one.camera_id)]) for one in of_one] for of_one in found
        ]
        tried = [evaluate(of_one, labels, rig, config, classes=known) for of_one in at_exposure]
        evaluations = tried if tried[0].frames else None
    figures = [None, None] if evaluations is None else [summarise(one) for one in evaluations]
    return NetworkComparison(
        first=ComparedNetwork(consistency=judged[0], figures=figures[0]),
        second=ComparedNetwork(consistency=judged[1], figures=figures[1]),
        instants=len(instants),
        frames=sum(len(rig.keys() & instant.frame_times_ns.keys()) for instant in instants),
        from_s=instants[0].time_ns * 1e-9,
        to_s=instants[-1].time_ns * 1e-9,
        labels="none" if evaluations is None else "hand",
        other_views=_of_other_views(*agreed),
        significance=None if evaluations is None else significance(*evaluations),
        not_asked_for=[str(kind) for kind in CLASSES if kind not in known],
        cautions=list(cautions),
    )


def _of_other_views(first: Sequence[Agreement], second: Sequence[Agreement]) -> Significance:
    """Both tests of the IoU in other views."""
    return both_tests(*_by_vehicle(first), *_by_vehicle(second))


def _by_vehicle(found: Sequence[Agreement]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """IoUs (K,) and whose they are (K,): the id of a track; those who were not followed are one between them."""
    rows = [(iou, one.track_id) for one in found for iou in one.other_ious]
    return np.array([iou for iou, _ in rows], float), np.array([owner for _, owner in rows], np.int64)
