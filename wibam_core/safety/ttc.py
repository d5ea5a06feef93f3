"""Time to collision of oriented footprints that keep their velocity.

Two convex shapes that translate touch exactly while their shadows on every edge normal overlap (separating-axis
theorem). Each shadow pair overlaps for one interval of time, in closed form; the shapes touch in the intersection
of the intervals. There is no time step, and no heading is derived from a velocity: a vehicle at rest has its box's yaw.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.geometry.box3d import LENGTH, WIDTH, XY, YAW

Array = NDArray[np.float64]

#: Slower closing than this is rounding: two that drive alike never meet.
_STILL_MPS = 1e-9


def contact_interval(
    boxes_a: ArrayLike, velocities_a: ArrayLike, boxes_b: ArrayLike, velocities_b: ArrayLike
) -> tuple[Array, Array]:
    """When footprints a (..., 7) and b (..., 7), m and rad, with velocities (..., 2), m/s, touch or overlap.

    Returns:
        first and last moment of contact (...,) in s from now, negative in the past; (inf, −inf) where there is none.
    """
    a, b = np.asarray(boxes_a, dtype=np.float64), np.asarray(boxes_b, dtype=np.float64)
    offset = b[..., XY] - a[..., XY]
    velocity = np.asarray(velocities_b, dtype=np.float64) - np.asarray(velocities_a, dtype=np.float64)
    shape = np.broadcast_shapes(offset.shape[:-1], velocity.shape[:-1])
    first, last = np.full(shape, -np.inf), np.full(shape, np.inf)
    ahead_a, ahead_b = ((np.cos(box[..., YAW]), np.sin(box[..., YAW])) for box in (a, b))
    c = np.abs(ahead_a[0] * ahead_b[0] + ahead_a[1] * ahead_b[1])
    s = np.abs(ahead_a[0] * ahead_b[1] - ahead_a[1] * ahead_b[0])
    (length_a, width_a), (length_b, width_b) = ((0.5 * box[..., LENGTH], 0.5 * box[..., WIDTH]) for box in (a, b))
    for (x, y), reach in (
        (ahead_a, length_a + length_b * c + width_b * s),
        ((-ahead_a[1], ahead_a[0]), width_a + length_b * s + width_b * c),
        (ahead_b, length_b + length_a * c + width_a * s),
        ((-ahead_b[1], ahead_b[0]), width_b + length_a * s + width_a * c),
    ):
        gap = offset[..., 0] * x + offset[..., 1] * y
        closing = velocity[..., 0] * x + velocity[..., 1] * y
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            one, other = (-reach - gap) / closing, (reach - gap) / closing
        still = np.abs(closing) < _STILL_MPS
        together = np.abs(gap) <= reach
        enter = np.where(still, np.where(together, -np.inf, np.inf), np.minimum(one, other))
        leave = np.where(still, np.where(together, np.inf, -np.inf), np.maximum(one, other))
        first, last = np.maximum(first, enter), np.minimum(last, leave)
    never = first > last
    return np.where(never, np.inf, first), np.where(never, -np.inf, last)


def time_to_collision(
    boxes_a: ArrayLike, velocities_a: ArrayLike, boxes_b: ArrayLike, velocities_b: ArrayLike
) -> Array:
    """Time (...,) in s until footprints a and b touch if both keep their velocity (shapes as `contact_interval`).

    0 where they overlap now, and only there; inf where they never meet, contacts in the past included.
    """
    first, last = contact_interval(boxes_a, velocities_a, boxes_b, velocities_b)
    return np.where(last < 0, np.inf, np.maximum(first, 0.0))


def footprints_touch(boxes_a: ArrayLike, boxes_b: ArrayLike) -> NDArray[np.bool_]:
    """Whether footprints a (..., 7) and b (..., 7) touch or overlap now."""
    a, b = np.asarray(boxes_a, dtype=np.float64), np.asarray(boxes_b, dtype=np.float64)
    offset = b[..., XY] - a[..., XY]
    turn = b[..., YAW] - a[..., YAW]
    c, s = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    (length_a, width_a), (length_b, width_b) = ((0.5 * box[..., LENGTH], 0.5 * box[..., WIDTH]) for box in (a, b))
    touch = np.ones(c.shape, bool)
    for yaw, reach_ahead, reach_aside in (
        (a[..., YAW], length_a + length_b * c + width_b * s, width_a + length_b * s + width_b * c),
        (b[..., YAW], length_b + length_a * c + width_a * s, width_b + length_a * s + width_a * c),
    ):
        x, y = np.cos(yaw), np.sin(yaw)
        touch &= np.abs(offset[..., 0] * x + offset[..., 1] * y) <= reach_ahead
        touch &= np.abs(offset[..., 1] * x - offset[..., 0] * y) <= reach_aside
    return touch
