"""Views that are cut from one wide lens overlap: what two of them show counts once, as one camera saw it once.

A box of one view is carried over to another by the rays through its border. Where it then agrees with a box there, as
far as both views reach, the two are one vehicle, and the view keeps it that shows it whole, or else nearer to its
middle.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.boxes2d import areas_px2, clipped_to_image, image_iou, intersections_px2
from wibam_core.geometry.camera import Camera
from wibam_core.scene import Boxes2D, CameraRig, FrameKey

FloatArray = NDArray[np.float64]

#: Two boxes are one vehicle where they overlap by this much; where the border of a view cuts one, also where one lies
#: in the other by this share and they overlap by a little.
_SAME_IOU = 0.45
_INSIDE, _CUT_IOU = 0.7, 0.15
#: A side this near to the border of a view is cut by it, px.
_CUT_PX = 2.0
#: Points along each side of a box that are carried over.
_SIDE = np.linspace(0.0, 1.0, 9)


def seen_once(detected: Mapping[FrameKey, Boxes2D], rig: CameraRig) -> dict[FrameKey, Boxes2D]:
    """Detections without what another view of the same camera shows better.

    Args:
        detected: frame -> boxes, px of the view.
        rig: with the views.
    """
    kept = {frame: np.ones(len(boxes.boxes), dtype=bool) for frame, boxes in detected.items()}
    moments = {(rig.mounted_id(frame.camera_id), frame.local_ns) for frame in detected}
    for camera_id, local_ns in sorted(moments):
        views = [view.id for view in rig.views.get(camera_id, ()) if FrameKey(view.id, local_ns) in detected]
        for one, other in combinations(views, 2):
            a, b = FrameKey(one, local_ns), FrameKey(other, local_ns)
            for i, j in _same(rig[one], detected[a].boxes, rig[other], detected[b].boxes):
                if kept[a][i] and kept[b][j]:
                    first = _quality(rig[one], detected[a].boxes[i]) >= _quality(rig[other], detected[b].boxes[j])
                    kept[b if first else a][j if first else i] = False
    return {frame: boxes.where(kept[frame]) for frame, boxes in detected.items()}


def _same(one: Camera, boxes: FloatArray, other: Camera, others: FloatArray) -> list[tuple[int, int]]:
    """Which boxes (N, 4) of one view and boxes (M, 4) of another show one vehicle, the surest pairs first."""
    if not len(boxes) or not len(others):
        return []
    there, here = _carried(one, boxes, other), _carried(other, others, one)
    # compared in both views, each as far as the other reaches; a pair must agree in one of them
    overlap = np.maximum(image_iou(there, others), image_iou(boxes, here))
    smaller = np.minimum(areas_px2(there)[:, None], areas_px2(others)[None, :])
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = np.nan_to_num(intersections_px2(there, others) / smaller)
    cut = _is_cut(one, boxes)[:, None] | _is_cut(other, others)[None, :]
    same = (overlap >= _SAME_IOU) | (cut & (inside >= _INSIDE) & (overlap >= _CUT_IOU))
    pairs: list[tuple[int, int]] = []
    rows, columns = np.nonzero(same)
    for k in np.argsort(-overlap[rows, columns], kind="stable").tolist():
        i, j = int(rows[k]), int(columns[k])
        if all(i != p and j != q for p, q in pairs):
            pairs.append((i, j))
    return pairs


def _carried(one: Camera, boxes: FloatArray, other: Camera) -> FloatArray:
    """Boxes (N, 4) of one view around what they show in another from the same place; NaN where that is nothing."""
    x0, y0, x1, y1 = boxes.T[:, :, None]
    x, y = x0 + (x1 - x0) * _SIDE, y0 + (y1 - y0) * _SIDE
    sides = [(x, y0 + 0 * x), (x, y1 + 0 * x), (x0 + 0 * y, y), (x1 + 0 * y, y)]
    border = np.concatenate([np.stack(side, axis=-1) for side in sides], axis=1)
    pixels, _ = other.project(one.rays(border) + other.centre_m)
    ahead = np.isfinite(pixels)
    low = np.where(ahead, pixels, np.inf).min(axis=1)
    high = np.where(ahead, pixels, -np.inf).max(axis=1)
    carried = clipped_to_image(np.concatenate([low, high], axis=1), other.width_px, other.height_px)
    return np.where((carried[:, 2:] > carried[:, :2]).all(axis=1, keepdims=True), carried, np.nan)


def _is_cut(view: Camera, boxes: FloatArray) -> NDArray[np.bool_]:
    """(N,) whether the left or right border of the view cuts boxes (N, 4)."""
    return np.asarray((boxes[:, 0] < _CUT_PX) | (boxes[:, 2] > view.width_px - 1 - _CUT_PX))


def _quality(view: Camera, box: FloatArray) -> tuple[bool, float]:
    """How well a view shows a box (4,): whole, and near its middle."""
    middle = (box[0] + box[2]) / 2
    return not bool(_is_cut(view, box[None])[0]), -abs(float(middle) / view.width_px - 0.5)
