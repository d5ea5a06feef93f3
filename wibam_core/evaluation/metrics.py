"""The five metrics of matched boxes, and the published evaluation's variants of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import LENGTH, SIZE, WIDTH, XY, XYZ, YAW
from wibam_core.geometry.iou import bev_intersection_paired, bev_iou_paired, iou_3d_paired
from wibam_core.geometry.se3 import normalise_angle

Array = NDArray[np.float64]

METRICS = ("bev_iou", "iou_3d", "ate_m", "ase", "aoe_deg")

#: The published evaluation leaves larger yaw errors out of its mean.
PAPER_ALIAS_DEG = 150.0


@dataclass(frozen=True, eq=False)
class MatchMetrics:
    """Per matched pair (K,).

    Attributes:
        bev_iou, iou_3d: overlap of footprints and of volumes.
        ate_m: translation error: distance of the centres.
        ase: scale error: 1 − IoU of the footprints once position and rotation are aligned.
        aoe_deg: orientation error: smallest yaw difference, in [0, 180]; NaN where it is left out.
    """

    bev_iou: Array
    iou_3d: Array
    ate_m: Array
    ase: Array
    aoe_deg: Array


def compare(predicted: Array, truth: Array) -> MatchMetrics:
    """Metrics of predicted boxes (K, 7) against the true ones (K, 7), pair by pair."""
    return MatchMetrics(
        bev_iou=bev_iou_paired(predicted, truth),
        iou_3d=iou_3d_paired(predicted, truth),
        ate_m=np.linalg.norm(predicted[:, XYZ] - truth[:, XYZ], axis=1),
        ase=scale_error(predicted, truth),
        aoe_deg=np.degrees(np.abs(normalise_angle(predicted[:, YAW] - truth[:, YAW]))),
    )


def box_errors(predicted: Array, truth: Array) -> Array:
    """(K, 7) predicted less true boxes (K, 7), the yaw in (−π, π]."""
    errors = predicted - truth
    errors[:, YAW] = normalise_angle(errors[:, YAW])
    return errors


def compare_as_published(predicted: Array, truth: Array) -> MatchMetrics:
    """The same with the quirks of the published evaluation.

    - The union of the 3D IoU subtracts the overlap's area, not its volume: a perfect box 1.5 m high scores 0.75.
    - The translation error has no z.
    - A yaw error of 150° or more is left out (NaN); see `alias_share`.
    """
    exact = compare(predicted, truth)
    area = bev_intersection_paired(predicted, truth)
    volumes = predicted[:, SIZE].prod(axis=1) + truth[:, SIZE].prod(axis=1)
    overlap = exact.iou_3d * volumes / (1.0 + exact.iou_3d)
    return MatchMetrics(
        bev_iou=exact.bev_iou,
        iou_3d=overlap / (volumes - area),
        ate_m=np.linalg.norm(predicted[:, XY] - truth[:, XY], axis=1),
        ase=exact.ase,
        aoe_deg=np.where(exact.aoe_deg < PAPER_ALIAS_DEG, exact.aoe_deg, np.nan),
    )


def alias_share(predicted: Array, truth: Array) -> float:
    """Share of pairs whose yaw error is 150° or more: the heading's sign was taken for its opposite."""
    return float(np.mean(compare(predicted, truth).aoe_deg >= PAPER_ALIAS_DEG)) if len(predicted) else float("nan")


def scale_error(predicted: Array, truth: Array) -> Array:
    """1 − IoU (K,) of footprints of boxes (K, 7) with the same centre and yaw."""
    overlap = np.minimum(predicted[:, LENGTH], truth[:, LENGTH]) * np.minimum(predicted[:, WIDTH], truth[:, WIDTH])
    union = predicted[:, LENGTH] * predicted[:, WIDTH] + truth[:, LENGTH] * truth[:, WIDTH] - overlap
    return 1.0 - overlap / union
