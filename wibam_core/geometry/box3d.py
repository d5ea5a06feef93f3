"""Oriented boxes that stand upright: seven degrees of freedom.

Vehicle frame: x forward, y left, z up, origin at the geometric centre. Corners are numbered

              5 ---------- 4
             /|           /|
            / |          / |        z  x (forward)
           6 ---------- 7  |        | /
           |  |         |  |        |/
           |  1 --------|- 0   y ---+
           | /          | /
           |/           |/
           2 ---------- 3

so that 0–3 are the bottom (0 front left seen from above going counter-clockwise: front-left, rear-left,
rear-right, front-right) and 4–7 the top above 0–3.

Many boxes are one float64 array (..., 7) in the order of `BOX_FIELDS`: centre x, y, z (m), length, width,
height (m), yaw (rad about world +Z, counter-clockwise from +X).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

BOX_FIELDS = ("x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "yaw_rad")
#: The columns of boxes (..., 7), and of their errors and standard deviations.
X, Y, Z, LENGTH, WIDTH, HEIGHT, YAW = range(7)
#: The centre over the ground and in space; length, width and height; the footprint's sides.
XY, XYZ, SIZE, SIZE_XY = slice(X, Z), slice(X, LENGTH), slice(LENGTH, YAW), slice(LENGTH, HEIGHT)
#: What changes as a vehicle moves.
POSE = [X, Y, YAW]

#: (8, 3) corners of the unit box, in the numbering above; multiply by (length, width, height).
UNIT_CORNERS: Array = 0.5 * np.array(
    [[1, 1, -1], [-1, 1, -1], [-1, -1, -1], [1, -1, -1], [1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]],
    dtype=np.float64,
)
UNIT_CORNERS.setflags(write=False)

#: (12, 2) corner numbers of the box's edges.
EDGES: NDArray[np.int64] = np.array(
    [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
)
EDGES.setflags(write=False)


def vehicle_to_world(boxes: ArrayLike, points_vehicle: ArrayLike) -> Array:
    """Points (..., K, 3) in m in the vehicle frames of boxes (..., 7), in the world (..., K, 3)."""
    b = np.asarray(boxes, dtype=np.float64)
    points = np.asarray(points_vehicle, dtype=np.float64)
    c, s = np.cos(b[..., YAW, None]), np.sin(b[..., YAW, None])
    x = c * points[..., 0] - s * points[..., 1] + b[..., X, None]
    y = s * points[..., 0] + c * points[..., 1] + b[..., Y, None]
    z = points[..., 2] + b[..., Z, None]
    return np.stack([x, y, z], axis=-1)


def corners(boxes: ArrayLike) -> Array:
    """World corners (..., 8, 3) of boxes (..., 7), in the numbering of this module."""
    b = np.asarray(boxes, dtype=np.float64)
    return vehicle_to_world(b, UNIT_CORNERS * b[..., None, SIZE])


def footprints(boxes: ArrayLike) -> Array:
    """Ground rectangles (..., 4, 2) of boxes (..., 7), counter-clockwise, corners 0–3 of `corners`."""
    return corners(boxes)[..., :4, :2]
