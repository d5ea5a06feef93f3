"""Quick figures of monocular predictions against truth, for choosing and describing weights."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from wibam_core.geometry.box3d import POSE, XY, YAW
from wibam_core.geometry.iou import bev_iou_paired, iou_3d_paired
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.training.views import FloatArray

_MATCH_DISTANCE_M = 4.0


@dataclass(frozen=True)
class ViewResult:
    """Boxes (P, 7) predicted in one view; (T, 7) true ones to be found; (I, 7) true ones that need not be."""

    predicted: FloatArray
    true: FloatArray
    optional: FloatArray


def measure(results: Iterable[ViewResult]) -> dict[str, float]:
    """Mean figures over matched vehicles (centres within 4 m on the ground), recall and precision.

    Keys: ``ate_m``, ``ase``, ``aoe_deg``, ``bev_iou``, ``iou_3d``, ``recall``, ``precision``, ``vehicles``.
    """
    pairs: list[tuple[FloatArray, FloatArray]] = []
    vehicles = found = 0
    for result in results:
        everything = np.concatenate([result.true, result.optional])
        rows, columns = _match(result.predicted, everything)
        wanted = columns < len(result.true)
        pairs.append((result.predicted[rows[wanted]], result.true[columns[wanted]]))
        vehicles += len(result.true)
        found += len(result.predicted) - int((~wanted).sum())
    predicted = np.concatenate([pair[0] for pair in pairs]) if pairs else np.zeros((0, 7))
    true = np.concatenate([pair[1] for pair in pairs]) if pairs else np.zeros((0, 7))
    figures = {"recall": len(true) / max(vehicles, 1), "precision": len(true) / max(found, 1), "vehicles": vehicles}
    if len(true) == 0:
        return figures
    aligned = predicted.copy()
    aligned[:, POSE] = true[:, POSE]
    turn = np.abs(normalise_angle(predicted[:, YAW] - true[:, YAW]))
    return figures | {
        "ate_m": float(np.hypot(*(predicted[:, XY] - true[:, XY]).T).mean()),
        "ase": float(1 - bev_iou_paired(aligned, true).mean()),
        "aoe_deg": float(np.degrees(turn).mean()),
        "aoe_median_deg": float(np.degrees(np.median(turn))),
        "bev_iou": float(bev_iou_paired(predicted, true).mean()),
        "iou_3d": float(iou_3d_paired(predicted, true).mean()),
    }


def _match(predicted: FloatArray, true: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    distance = np.linalg.norm(predicted[:, None, XY] - true[None, :, XY], axis=2)
    rows, columns = linear_sum_assignment(np.minimum(distance, 2 * _MATCH_DISTANCE_M))
    near = distance[rows, columns] <= _MATCH_DISTANCE_M
    return rows[near], columns[near]
