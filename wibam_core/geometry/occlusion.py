"""Who hides whom in an image, as far as 2D boxes tell.

A vehicle may be hidden by those that stand nearer to the camera; what of its box lies within one of theirs may be
theirs. All arrays are of the N vehicles in one image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.boxes2d import areas_px2, intersections_px2

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def stands_before(distance: Array, margin: float = 0.0) -> Mask:
    """(N, N) whether the vehicle of the column stands nearer than that of the row, by more than the margin.

    Args:
        distance: (N,) from the camera, in whatever unit ``margin`` has; infinite where unknown, which hides nothing.
        margin: smaller differences say nothing.
    """
    return np.asarray(distance[None, :] < distance[:, None] - margin)


def hidden_edges(boxes: Array, before: Mask, least_share: float, covers: Array, slack_px: float = 0.0) -> Mask:
    """Which edges (N, 4), left, top, right, bottom, of boxes may be those of what stands before them.

    An edge may be if it lies within the cover of such a vehicle, and that reaches along enough of its length.

    Args:
        boxes: (N, 4) xyxy, of what is seen, px.
        before: (N, N), see `stands_before`.
        least_share: of the edge's length.
        covers: (N, 4) xyxy, px: the boxes as those that hide; larger than ``boxes`` where these are not exact.
        slack_px: how far beyond a cover's border an edge still lies within it.
    """
    hidden = np.zeros(boxes.shape, dtype=bool)
    for side in range(4):
        axis, along = side % 2, 1 - side % 2
        at = boxes[:, side, None]
        within = (at >= covers[None, :, axis] - slack_px) & (at <= covers[None, :, 2 + axis] + slack_px)
        ends, starts = boxes[:, None, 2 + along], boxes[:, None, along]
        shared = np.minimum(ends, covers[None, :, 2 + along]) - np.maximum(starts, covers[None, :, along])
        share = shared / np.maximum(ends - starts, 1e-6)
        hidden[:, side] = (before & within & (share >= least_share)).any(axis=1)
    return hidden


def hidden_share(boxes: Array, before: Mask) -> Array:
    """(N,) largest share of each box (N, 4) that the box of one vehicle before it covers; 0 of boxes without area."""
    shared = intersections_px2(boxes, boxes) * before
    return np.asarray(shared.max(axis=1, initial=0.0) / np.maximum(areas_px2(boxes), 1e-9))
