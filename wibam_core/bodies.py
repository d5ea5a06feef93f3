"""The coarse body of each class of vehicle.

A vehicle is not its cuboid: its tight image box hugs a body with chamfered corners and an inset roof. Comparing the
cuboid's corners with such boxes shrinks it, so that a coarse body is compared instead.
"""

from __future__ import annotations

import numpy as np

from wibam_core.scene import CLASSES, FloatArray, VehicleClass


def _ring(
    front: float, rear: float, corner: float, half_width: float, inner: float, height: float
) -> list[list[float]]:
    """Eight points of a rectangle with cut corners at one height: ends at ``front`` and ``rear``, cut back by
    ``corner`` along the length, from ``half_width`` in to ``inner`` across."""
    points = []
    for side in (1.0, -1.0):
        points += [
            [front, side * inner, height],
            [front - corner, side * half_width, height],
            [rear + corner, side * half_width, height],
            [rear, side * inner, height],
        ]
    return points


def _pairs(*points: tuple[float, float, float]) -> list[list[float]]:
    """Points and their mirror images on the other side."""
    return [[x, side * y, z] for x, y, z in points for side in (1.0, -1.0)]


#: (24, 3) per class: x in lengths and y in widths from the centre, z in heights above the ground.
_BODIES: dict[VehicleClass, list[list[float]]] = {
    VehicleClass.CAR: [
        *_ring(0.5, -0.5, 0.07, 0.49, 0.36, 0.2),
        *_ring(0.48, -0.49, 0.08, 0.49, 0.36, 0.52),
        *_pairs((0.3, 0.47, 0.0), (-0.3, 0.47, 0.0), (0.1, 0.37, 1.0), (-0.3, 0.37, 1.0)),
    ],
    VehicleClass.VAN: [
        *_ring(0.5, -0.5, 0.05, 0.49, 0.4, 0.15),
        *_pairs((0.47, 0.38, 0.5), (0.42, 0.48, 0.5), (-0.5, 0.44, 0.5), (-0.48, 0.49, 0.5)),
        *_pairs((0.32, 0.47, 0.0), (-0.32, 0.47, 0.0), (0.24, 0.42, 1.0), (-0.47, 0.42, 1.0)),
    ],
    VehicleClass.TRUCK: [
        *_ring(0.5, -0.5, 0.03, 0.49, 0.43, 0.17),
        *_pairs((0.5, 0.43, 0.5), (0.47, 0.48, 0.5), (0.46, 0.44, 0.75), (-0.5, 0.5, 0.4)),
        *_pairs((0.33, 0.46, 0.0), (-0.3, 0.46, 0.0), (0.25, 0.49, 1.0), (-0.5, 0.49, 1.0)),
    ],
    VehicleClass.BUS: [
        *_ring(0.5, -0.5, 0.02, 0.5, 0.45, 0.12),
        *_ring(0.49, -0.5, 0.02, 0.49, 0.44, 0.85),
        *_pairs((0.28, 0.47, 0.0), (-0.26, 0.47, 0.0), (0.46, 0.44, 1.0), (-0.48, 0.44, 1.0)),
    ],
}

#: (classes, 24, 3) in the order of `CLASSES`; z from the centre, in heights, as in the vehicle frame.
TEMPLATES: FloatArray = np.array([_BODIES[c] for c in CLASSES]) - np.array([0.0, 0.0, 0.5])
TEMPLATES.setflags(write=False)
