"""Outlines of still things: ground markings, windows, signal heads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wibam_core.synthetic.layout import Arm, Building, SignalHead

Array = NDArray[np.float64]


def lift(ground: Array, z_m: float = 0.0) -> Array:
    """Ground points (N, 2) at a height, (N, 3)."""
    return np.concatenate([ground, np.full((len(ground), 1), z_m)], axis=1)


def upright(a: Array, b: Array, low_m: float, high_m: float) -> Array:
    """(4, 3) upright rectangle over the ground segment a–b."""
    return np.array([[*a, low_m], [*b, low_m], [*b, high_m], [*a, high_m]])


def windows(a: Array, b: Array, building: Building) -> Array:
    """(N, 4, 3) windows of the wall over the ground segment a–b."""
    length = float(np.linalg.norm(b - a))
    columns, storeys = max(1, int(length // 2.8)), max(1, int(building.height_m // building.storey_m))
    left = (np.arange(columns) + 0.22) / columns
    right = left + 0.56 / columns
    along = np.stack([left, right, right, left], axis=-1)
    ground = np.broadcast_to(a + along[..., None] * (b - a), (storeys, columns, 4, 2))
    low = np.arange(storeys) * building.storey_m + 0.9
    z = np.broadcast_to(low[:, None, None] + np.array([0, 0, 1.5, 1.5]), (storeys, columns, 4))
    return np.concatenate([ground, z[..., None]], axis=-1).reshape(-1, 4, 3)


def housing(head: SignalHead) -> list[Array]:
    """Back, sides and face of a signal head, the face last."""
    face = head.outline()
    back = face - 0.24 * np.array([np.cos(head.facing_rad), np.sin(head.facing_rad), 0])
    sides = [np.stack([face[i], face[j], back[j], back[i]]) for i, j in ((0, 1), (1, 2), (2, 3), (3, 0))]
    return [back, *sides, face]


def bracket(head: SignalHead) -> Array | None:
    """(4, 3) arm that leads from the pole to the head, or None where the head sits on its pole."""
    foot, tip = np.array([head.pole_x_m, head.pole_y_m]), np.array([head.x_m, head.y_m])
    if np.linalg.norm(tip - foot) < 0.1:
        return None
    return upright(foot, tip, head.z_m + 0.1, head.z_m + 0.26)


def markings(arm: Arm) -> list[Array]:
    """Ground polygons (4, 2) of lane lines, stop line and crosswalk."""
    end = arm.length_m + 40
    found = [arm.strip(arm.stop_m - 0.25, arm.stop_m + 0.25, 0.1, arm.in_edge_m - 0.1)]
    found.append(arm.strip(arm.stop_m, end, -0.07, 0.07))
    for lane in range(1, arm.incoming):
        found += _dashes(arm, lane * arm.lane_m, end)
    for lane in range(1, arm.outgoing):
        found += _dashes(arm, -lane * arm.lane_m, end)
    for edge in (arm.in_edge_m - 0.15, arm.out_edge_m + 0.15):
        found.append(arm.strip(arm.stop_m, end, edge - 0.06, edge + 0.06))
    first, last = arm.crosswalk_m
    for lateral in np.arange(arm.out_edge_m + 0.35, arm.in_edge_m - 0.5, 1.0):
        found.append(arm.strip(first, last, float(lateral), float(lateral) + 0.5))
    return found


def _dashes(arm: Arm, lateral: float, end: float) -> list[Array]:
    starts = np.arange(arm.stop_m + 0.5, end, 6.0)
    return [arm.strip(float(s), float(s) + 3.0, lateral - 0.06, lateral + 0.06) for s in starts]
