"""Which detection is which vehicle, in one frame of one camera. Two ways, always reported side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from wibam_core.geometry.box3d import SIZE, XY
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import project_boxes

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Quirks of the published evaluation, see `match_in_image`.
PAPER_MIN_IMAGE_IOU = 0.5
PAPER_MIN_SCORE = 0.4
PAPER_MAX_SIDE_M = 6.0


@dataclass(frozen=True, eq=False)
class FrameMatch:
    """Outcome for one frame.

    Attributes:
        labels, detections: (K,) indices of the matched pairs.
        missed: indices of labels that count and have no detection.
        false_positives: indices of detections without any label.
    """

    labels: Indices
    detections: Indices
    missed: Indices
    false_positives: Indices


def assign(cost: Array, limit: float) -> tuple[Indices, Indices]:
    """Pairs (rows, columns) of the least total cost, where two that are left alone cost as much as a pair at ``limit``.

    Pairs cost less than ``limit``. Asking for the most pairs first would credit a missed vehicle with its neighbour's
    detection and that neighbour with a false one.
    """
    if not cost.size:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    rows, columns = linear_sum_assignment(np.minimum(cost, limit))
    near = cost[rows, columns] < limit
    return rows[near].astype(np.int64), columns[near].astype(np.int64)


def match_on_ground(
    labels: Array,
    counts: NDArray[np.bool_],
    detections: Array,
    max_distance_m: float,
    possible: NDArray[np.bool_] | None = None,
) -> FrameMatch:
    """Optimal assignment by the distance of centres in the ground plane.

    Labels that do not count (hidden, far away) take part, so that the detection of one is not credited to another
    vehicle beside it; it is then neither a hit nor a false positive, nor is any other detection near such a label.

    Args:
        labels: (M, 7) all labelled vehicles.
        counts: (M,) which of them a detector is asked for.
        detections: (N, 7).
        max_distance_m: a pair this far apart or farther is no match.
        possible: (M, N) which pairs may be one road user; None: all.
    """
    distance = np.linalg.norm(labels[:, None, XY] - detections[None, :, XY], axis=-1)
    if possible is not None:
        distance = np.where(possible, distance, np.inf)
    near = distance < max_distance_m
    rows, columns = assign(distance, max_distance_m)
    hits = counts[rows]
    excused = near[~counts].any(axis=0) if (~counts).any() else np.zeros(len(detections), bool)
    unmatched = np.ones(len(detections), bool)
    unmatched[columns] = False
    missed = counts.copy()
    missed[rows] = False
    return FrameMatch(rows[hits], columns[hits], np.flatnonzero(missed), np.flatnonzero(unmatched & ~excused))


def match_in_image(labels: Array, visible: NDArray[np.bool_], detections: Array, camera: Camera) -> FrameMatch:
    """As published: pairs whose tight image boxes overlap with IoU > 0.5; nothing else is counted.

    A detection whose image box overlaps too little is dropped however right or wrong its place is, and neither
    misses nor false positives are kept: that selects the good ones.

    Args:
        labels: (M, 7).
        visible: (M,) which are seen at all.
        detections: (N, 7), as filtered by `paper_filter`.
        camera: the frame's.
    """
    candidates = np.flatnonzero(visible)
    overlap = image_iou(project_boxes(camera, labels[candidates]), project_boxes(camera, detections))
    rows, columns = assign(1.0 - overlap, 1.0 - PAPER_MIN_IMAGE_IOU)
    nothing = np.empty(0, np.int64)
    return FrameMatch(candidates[rows], columns, nothing, nothing)


def paper_filter(detections: Array, scores: Array) -> Indices:
    """As published: detections with a score of at least 0.4 and no side over 6 m (no truck or bus remains)."""
    return np.flatnonzero((scores >= PAPER_MIN_SCORE) & (detections[:, SIZE] <= PAPER_MAX_SIDE_M).all(axis=1))
