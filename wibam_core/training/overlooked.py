"""Vehicles that a view must show, since other views do, though nothing was detected there.

Detectors overlook what the border of the image cuts, and what is close. Left alone, such vehicles would be taught as
background, and the fine-tuned network would not find them either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.boxes2d import areas_px2, image_iou, sides_px
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.occlusion import hidden_share, stands_before
from wibam_core.geometry.outlines import outlines
from wibam_core.road_users import BODIES
from wibam_core.training.views import FloatArray

#: A vehicle teaches nothing if less than this share of its box lies within the image, or if that part is narrower or
#: lower than so many px.
_LEAST_SHARE, _LEAST_PX = 0.3, 8.0
#: A vehicle of whose box the nearer ones cover more than this share may be hidden.
_HIDDEN_SHARE = 0.3
#: A box found nearer than this IoU to a vehicle may be its own, though no one linked it.
_SAME_IOU = 0.3


@dataclass(frozen=True, eq=False)
class Overlooked:
    """Which of M vehicles a view shows without a box of their own.

    Attributes:
        rows: (K,) of the vehicles that are surely seen. boxes2d: (K, 4) xyxy, px: theirs, within the image.
        unsure: (U, 4) xyxy, px: boxes of vehicles that may be hidden, or be seen too little of.
    """

    rows: NDArray[np.int64]
    boxes2d: FloatArray
    unsure: FloatArray


def overlooked(
    camera: Camera, vehicles: FloatArray, classes: NDArray[np.int64], found: NDArray[np.bool_], boxes2d: FloatArray
) -> Overlooked:
    """What was overlooked in a view.

    Args:
        camera: of the view.
        vehicles: (M, 7) boxes of all vehicles about, in the world, when the frame is exposed.
        classes: (M,) indices into `CLASSES`.
        found: (M,) whether the view has a 2D box that is known to be the vehicle's.
        boxes2d: (N, 4) xyxy, px: all 2D boxes of the view.
    """
    seen = outlines(camera, vehicles, BODIES[classes])
    shown, whole = seen.shown, seen.whole
    own = image_iou(shown, boxes2d).max(axis=1, initial=0.0) > _SAME_IOU
    missing = seen.in_image & ~found & ~own
    clear = areas_px2(shown) >= _LEAST_SHARE * areas_px2(whole)
    clear &= sides_px(shown).min(axis=1, initial=np.inf) >= _LEAST_PX
    clear &= hidden_share(shown, stands_before(seen.distance_m)) <= _HIDDEN_SHARE
    rows = np.flatnonzero(missing & clear)
    return Overlooked(rows, shown[rows], shown[missing & ~clear])
