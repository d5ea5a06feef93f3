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
    for yaw in (a[..., YAW], a[..., YAW] + np.pi / 2, b[..., YAW], b[..., YAW] + np.pi / 2):
        axis = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        gap = (offset * axis).sum(-1)
        closing = (velocity * axis).sum(-1)
        reach = _half_shadow(a, yaw) + _half_shadow(b, yaw)
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
    still = np.zeros(2)
    first, _ = contact_interval(boxes_a, still, boxes_b, still)
    return np.asarray(first < np.inf)


def _half_shadow(boxes: Array, axis_yaw: Array) -> Array:
    """Half the length of the footprints' shadows on the direction ``axis_yaw``."""
    turn = boxes[..., YAW] - axis_yaw
    return 0.5 * (boxes[..., LENGTH] * np.abs(np.cos(turn)) + boxes[..., WIDTH] * np.abs(np.sin(turn)))
