"""An evaluation as figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.base import MeanSd, finite
from wibam_core.documents.metrics import Bin, DetectorFigures, OfClass
from wibam_core.evaluation.evaluate import Evaluation
from wibam_core.evaluation.metrics import METRICS
from wibam_core.road_users import CLASSES

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

VISIBILITY_EDGES = (0.0, 0.3, 0.5, 0.7, 0.9, 1.0)
DISTANCE_EDGES_M = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, math.inf)
ELEVATION_EDGES_DEG = (-math.inf, 10.0, 20.0, 30.0, math.inf)


def summarise(evaluation: Evaluation) -> DetectorFigures:
    """The five metrics over matches, and what matches alone do not tell.

    In `correct` mode also recall (s.d. over vehicles), precision, misses, false positives and the IoUs with every
    missed vehicle counted as 0: means over matches flatter a detector that finds only the easy ones.
    """
    matched = len(evaluation.matched.vehicle_ids)
    figures: dict[str, Any] = {name: mean_sd(getattr(evaluation.metrics, name)) for name in METRICS}
    if evaluation.mode == "correct":
        missed = len(evaluation.missed.vehicle_ids)
        zeros = np.zeros(missed)
        figures |= {
            "missed": missed,
            "false_positives": evaluation.false_positives,
            "recall": MeanSd(mean=_ratio(matched, matched + missed), sd=finite(_recall_sd(evaluation))),
            "precision": _ratio(matched, matched + evaluation.false_positives),
            "bev_iou_misses_zero": mean_sd(np.concatenate([evaluation.metrics.bev_iou, zeros])),
            "iou_3d_misses_zero": mean_sd(np.concatenate([evaluation.metrics.iou_3d, zeros])),
        }
    return DetectorFigures(
        **figures, matched=matched, frames=evaluation.frames, alias_share=finite(evaluation.alias_share)
    )


def by_visibility(evaluation: Evaluation) -> list[Bin]:
    """Metrics and recall in bins of the share of a vehicle that the camera sees."""
    return _binned(evaluation, evaluation.matched.visibility, evaluation.missed.visibility, VISIBILITY_EDGES)


def by_distance(evaluation: Evaluation) -> list[Bin]:
    """Metrics and recall in bins of the distance from the camera, m."""
    return _binned(evaluation, evaluation.matched.distance_m, evaluation.missed.distance_m, DISTANCE_EDGES_M)


def by_elevation(evaluation: Evaluation) -> list[Bin]:
    """Metrics and recall in bins of the angle between the ground and the ray from the camera to the vehicle, deg."""
    matched, missed = evaluation.matched.elevation_deg, evaluation.missed.elevation_deg
    return _binned(evaluation, matched, missed, ELEVATION_EDGES_DEG)


def by_class(evaluation: Evaluation) -> list[OfClass]:
    """Metrics and recall of every true class that there is."""
    found = []
    for number, name in enumerate(CLASSES):
        hit, miss = evaluation.matched.classes == number, evaluation.missed.classes == number
        if hit.any() or miss.any():
            found.append(OfClass(road_user_class=name.value, **_part(evaluation, hit, miss)))
    return found


def mean_sd(values: Array) -> MeanSd:
    """Mean and standard deviation (n − 1 in the denominator) of the finite values."""
    values = values[np.isfinite(values)]
    return MeanSd(
        mean=float(values.mean()) if len(values) else None,
        sd=float(values.std(ddof=1)) if len(values) > 1 else None,
    )


def _binned(evaluation: Evaluation, matched: Array, missed: Array, edges: Sequence[float]) -> list[Bin]:
    """Half-open bins ``low < value <= high`` that hold anything; the first takes its lower edge too."""
    bins = []
    for low, high in pairwise(edges):
        hit = (matched > low) & (matched <= high) | ((low == edges[0]) & (matched == low))
        miss = (missed > low) & (missed <= high) | ((low == edges[0]) & (missed == low))
        if not hit.any() and not miss.any():
            continue
        bins.append(Bin(low=finite(low), high=finite(high), **_part(evaluation, hit, miss)))
    return bins


def _part(evaluation: Evaluation, hit: Mask, miss: Mask) -> dict[str, Any]:
    """Figures of some matched (K,) and some missed vehicles (M,)."""
    return {
        "matched": int(hit.sum()),
        "missed": int(miss.sum()),
        "recall": _ratio(int(hit.sum()), int(hit.sum() + miss.sum())),
        **{name: mean_sd(getattr(evaluation.metrics, name)[hit]) for name in METRICS},
    }


def _recall_sd(evaluation: Evaluation) -> float:
    """Standard deviation of the single vehicles' recall."""
    ids = np.concatenate([evaluation.matched.vehicle_ids, evaluation.missed.vehicle_ids])
    found = np.concatenate([np.ones(len(evaluation.matched.vehicle_ids)), np.zeros(len(evaluation.missed.vehicle_ids))])
    _, vehicle = np.unique(ids, return_inverse=True)
    recalls = np.bincount(vehicle, weights=found) / np.maximum(np.bincount(vehicle), 1)
    return float(recalls.std(ddof=1)) if len(recalls) > 1 else float("nan")


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None
