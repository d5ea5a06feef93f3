"""3D boxes that two views of one wide lens show: one measurement, not two."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import XYZ
from wibam_core.geometry.camera import Camera
from wibam_core.road_users import may_be_one
from wibam_core.scene import CameraRig, Vehicles3D
from wibam_core.tracking.fusion import REACH, ground_distance

Array = NDArray[np.float64]


def found_once(found: Sequence[Vehicles3D], rig: CameraRig, radius_m: float) -> list[Vehicles3D]:
    """What all views detected at one instant, without what another view of the same camera shows nearer to its middle.

    Args:
        found: one entry per view.
        rig: with the views.
        radius_m: boxes of one vehicle lie this near to each other, see `ground_distance`.
    """
    kept = [np.ones(len(vehicles), dtype=bool) for vehicles in found]
    for a, b in combinations(range(len(found)), 2):
        one, other = found[a], found[b]
        if rig.mounted_id(str(one.camera_id)) != rig.mounted_id(str(other.camera_id)):
            continue
        distance = ground_distance(one.boxes, other.boxes)
        reach = radius_m * np.maximum(REACH[one.classes][:, None], REACH[other.classes])
        rows, columns = np.nonzero((distance <= reach) & may_be_one(one.classes, other.classes))
        off_a = _off_middle(rig[str(one.camera_id)], one.boxes)
        off_b = _off_middle(rig[str(other.camera_id)], other.boxes)
        for k in np.argsort(distance[rows, columns], kind="stable").tolist():
            i, j = rows[k], columns[k]
            if kept[a][i] and kept[b][j]:
                if off_a[i] <= off_b[j]:
                    kept[b][j] = False
                else:
                    kept[a][i] = False
    return [vehicles.where(rows) for vehicles, rows in zip(found, kept, strict=True)]


def _off_middle(view: Camera, boxes: Array) -> Array:
    """(N,) how far from the middle of a view the centres of boxes (N, 7) are seen, in widths."""
    pixels, _ = view.project(boxes[:, XYZ])
    return np.nan_to_num(np.abs(pixels[:, 0] / view.width_px - 0.5), nan=np.inf)
