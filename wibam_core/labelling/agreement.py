"""How far two people who labelled the same instants agree: what no detector's figure can be better than."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from wibam_core.documents.base import MeanSd
from wibam_core.documents.hand_labels import Agreement, HandLabels
from wibam_core.evaluation.matching import match_on_ground
from wibam_core.evaluation.metrics import METRICS, MatchMetrics, compare
from wibam_core.labelling.labels import asked_for, boxes_of, visibility_of
from wibam_core.scene import CameraRig, FloatArray

#: Boxes of one vehicle are nearer than this, m.
_MAX_DISTANCE_M = 2.0


def agreement(first: Iterable[HandLabels], second: Iterable[HandLabels], rig: CameraRig) -> Agreement:
    """Compare two sets of labels at the instants that both have finished; vehicles are matched by where they stand."""
    theirs = {labels.time_ns: labels for labels in second if labels.finished}
    both = [(labels, theirs[labels.time_ns]) for labels in first if labels.finished and labels.time_ns in theirs]
    figures: dict[str, list[float]] = {name: [] for name in METRICS}
    visibility: list[float] = []
    same: list[bool] = []
    only_first = only_second = 0
    for one, other in both:
        boxes, others = boxes_of(one), boxes_of(other)
        counts, counts_other = asked_for(one), asked_for(other)
        match = match_on_ground(boxes, counts, others, _MAX_DISTANCE_M)
        kept = counts_other[match.detections]
        a, b = match.labels[kept], match.detections[kept]
        compared: MatchMetrics = compare(boxes[a], others[b])
        for name, values in figures.items():
            values += np.asarray(getattr(compared, name)).tolist()
        visibility += _differences(visibility_of(one, rig), visibility_of(other, rig), a, b)
        same += [one.vehicles[i].vehicle_class is other.vehicles[j].vehicle_class for i, j in zip(a, b, strict=True)]
        only_first += len(match.missed)
        only_second += int(counts_other[match.false_positives].sum())
    return Agreement(
        instants=len(both),
        pairs=len(same),
        only_first=only_first,
        only_second=only_second,
        **{name: _mean_sd(values) for name, values in figures.items()},
        visibility=_mean_sd(visibility),
        same_class=float(np.mean(same)) if same else None,
    )


def _differences(one: dict[str, FloatArray], other: dict[str, FloatArray], a: np.ndarray, b: np.ndarray) -> list[float]:
    found: list[float] = []
    for camera_id in one.keys() & other.keys():
        shares, others = one[camera_id][a], other[camera_id][b]
        seen = (shares > 0) | (others > 0)
        found += np.abs(shares - others)[seen].tolist()
    return found


def _mean_sd(values: list[float]) -> MeanSd:
    return MeanSd(
        mean=float(np.mean(values)) if values else None, sd=float(np.std(values, ddof=1)) if len(values) > 1 else None
    )
