"""Boxes of one camera followed over time in the image: there a vehicle hardly moves from one frame to the next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from wibam_core.geometry.boxes2d import image_iou
from wibam_core.road_users import VULNERABLE
from wibam_core.scene import AnnotatedInstant, Detections2D, FloatArray, IntArray

#: A box goes on with a vehicle if its IoU with where that is expected is at least the first number right after the
#: vehicle was seen; the second is what is taken off for every second since, and the third the least that is asked for.
_IOU_AT_ONCE, _IOU_PER_S, _LEAST_IOU = 0.55, 0.5, 0.3
#: People and their two-wheelers are narrow, and move by much of their width from one frame to the next: their boxes are
#: widened on every side by this share of their sides before they are compared (as by Yang et al. 2023,
#: arXiv 2211.14317).
_WIDENED_SHARE = 0.3
#: How fast the speed of a box's edges follows what is seen.
_SPEED_GAIN = 0.4


def tracklets(
    instants: Sequence[AnnotatedInstant], camera_ids: Sequence[str], max_gap_s: float
) -> list[dict[str, IntArray]]:
    """Number the boxes of every camera so that consecutive ones of a vehicle have one number.

    Args:
        instants: in order of time.
        camera_ids: whose boxes.
        max_gap_s: a vehicle that is not found for longer begins anew.

    Returns:
        For every instant, by camera, the number (N,) of each box, unique over all cameras.
    """
    found: list[dict[str, IntArray]] = [{} for _ in instants]
    count = 0
    for camera_id in camera_ids:
        active = _Active(max_gap_s)
        for number, instant in enumerate(instants):
            seen = instant.detections.get(camera_id)
            if seen is not None:
                found[number][camera_id], count = active.follow(seen, count)
    return found


class _Active:
    """The T boxes that may be gone on with.

    Attributes:
        ids: (T,) numbers. times_s: (T,) when each was seen last.
        boxes: (T, 4) then. speeds: (T, 4) of their edges, px/s. vulnerable: (T,) whether it is no vehicle.
    """

    def __init__(self, max_gap_s: float) -> None:
        self._max_gap_s = max_gap_s
        self.ids, self.times_s = np.empty(0, np.int64), np.empty(0)
        self.boxes, self.speeds = np.empty((0, 4)), np.empty((0, 4))
        self.vulnerable = np.empty(0, dtype=bool)

    def follow(self, seen: Detections2D, count: int) -> tuple[IntArray, int]:
        """Numbers (N,) of the boxes seen, new ones from ``count`` on, and the next new number."""
        now_s, found = seen.frame_time_ns * 1e-9, seen.whole_boxes
        alive = now_s - self.times_s <= self._max_gap_s
        since = (now_s - self.times_s[alive])[:, None]
        ids, boxes, speeds = self.ids[alive], self.boxes[alive], self.speeds[alive]
        times_s, vulnerable = self.times_s[alive], self.vulnerable[alive]
        now_vulnerable = VULNERABLE[seen.classes]
        expected = _widened(boxes + speeds * since, vulnerable)
        overlap = image_iou(expected, _widened(found, now_vulnerable))
        allowed = vulnerable[:, None] == now_vulnerable
        allowed &= overlap >= np.maximum(_IOU_AT_ONCE - _IOU_PER_S * since, _LEAST_IOU)
        rows, columns = linear_sum_assignment(np.where(allowed, -overlap, 0.0))
        good = allowed[rows, columns]
        rows, columns = rows[good], columns[good]
        names = np.full(len(seen), -1, dtype=np.int64)
        names[columns] = ids[rows]
        fresh = np.flatnonzero(names < 0)
        names[fresh] = count + np.arange(len(fresh))
        moved = (found[columns] - boxes[rows]) / np.maximum(since[rows], 1e-3)
        speeds[rows] += _SPEED_GAIN * (moved - speeds[rows])
        boxes[rows], times_s[rows] = found[columns], now_s
        self.ids = np.concatenate([ids, names[fresh]])
        self.boxes = np.concatenate([boxes, found[fresh]])
        self.speeds = np.concatenate([speeds, np.zeros((len(fresh), 4))])
        self.times_s = np.concatenate([times_s, np.full(len(fresh), now_s)])
        self.vulnerable = np.concatenate([vulnerable, now_vulnerable[fresh]])
        return names, count + len(fresh)


def _widened(boxes: FloatArray, which: NDArray[np.bool_]) -> FloatArray:
    """The boxes (N, 4), those of ``which`` (N,) larger."""
    margin = _WIDENED_SHARE * which[:, None] * (boxes[:, 2:] - boxes[:, :2])
    return np.concatenate([boxes[:, :2] - margin, boxes[:, 2:] + margin], axis=1)
