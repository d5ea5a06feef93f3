"""Post-encroachment time: from the first road user leaving a place to the second one reaching it, as driven."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wibam_core.geometry.box3d import SIZE_XY, XY, YAW
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.safety.trajectory import resample
from wibam_core.safety.ttc import footprints_touch
from wibam_core.scene import Track

Array = NDArray[np.float64]

#: Tracks are compared at this step, then around the smallest time between them at the finer one.
_COARSE_S = 0.05
_FINE_S = 0.0025
#: Paths are compared as lines between places that lie so far apart.
_STEP_M = 1.5


@dataclass(frozen=True)
class Encroachment:
    """The place that two road users shared with the least time between them.

    Attributes:
        pet_s: time between the first leaving and the second arriving, within 2 · 2.5 ms for tracks that are straight
            between instants; 0 where both were there at once.
        first_index: 0 if the first track was there first, 1 if the second was.
        leaves_ns, arrives_ns: when the first left and the second arrived.
        x_m, y_m: the place, between the two footprints' centres.
    """

    pet_s: float
    first_index: int
    leaves_ns: int
    arrives_ns: int
    x_m: float
    y_m: float


def post_encroachment(
    a: Track, b: Track, *, max_pet_s: float = 10.0, min_heading_difference_rad: float = 0.0
) -> Encroachment | None:
    """The smallest time between footprint ``a`` at one place and footprint ``b`` at the same place, either first.

    Every pair of moments is compared at which the two footprints touch: the conflict area is where the swept paths
    cross, whatever its shape.

    Args:
        a: one track.
        b: the other, on the same clock.
        max_pet_s: longer times are not looked for.
        min_heading_difference_rad: places that both pass in about the same direction, as a follower does, are left
            out below this difference; where it is given, the paths must cut each other at such an angle, too.

    Returns:
        None where the paths do not share a place within ``max_pet_s``.
    """
    if min_heading_difference_rad > 0 and not paths_cross(a.boxes[:, XY], b.boxes[:, XY], min_heading_difference_rad):
        return None
    times_a, times_b = (
        _grid(a, int(a.times_ns[0]), int(a.times_ns[-1]), _COARSE_S),
        _grid(b, int(b.times_ns[0]), int(b.times_ns[-1]), _COARSE_S),
    )
    found = _closest_in_time(a, b, times_a, times_b, max_pet_s, min_heading_difference_rad)
    if found is None:
        return None
    around = int(1.5 * _COARSE_S * 1e9)
    fine = _closest_in_time(
        a,
        b,
        _grid(a, found[0] - around, found[0] + around, _FINE_S),
        _grid(b, found[1] - around, found[1] + around, _FINE_S),
        max_pet_s,
        min_heading_difference_rad,
    )
    time_a, time_b = fine if fine is not None and abs(fine[0] - fine[1]) < abs(found[0] - found[1]) else found
    place = 0.5 * (resample(a, np.array([time_a])).boxes[0, XY] + resample(b, np.array([time_b])).boxes[0, XY])
    return Encroachment(
        pet_s=abs(time_a - time_b) * 1e-9,
        first_index=0 if time_a <= time_b else 1,
        leaves_ns=min(time_a, time_b),
        arrives_ns=max(time_a, time_b),
        x_m=float(place[0]),
        y_m=float(place[1]),
    )


def _grid(track: Track, start_ns: int, end_ns: int, step_s: float) -> NDArray[np.int64]:
    start, end = max(start_ns, int(track.times_ns[0])), min(end_ns, int(track.times_ns[-1]))
    return np.append(np.arange(start, end, int(step_s * 1e9), dtype=np.int64), end)


def _closest_in_time(
    a: Track,
    b: Track,
    times_a: NDArray[np.int64],
    times_b: NDArray[np.int64],
    max_pet_s: float,
    min_heading_difference_rad: float,
) -> tuple[int, int] | None:
    """The pair of times, one of each track, with touching footprints and the least time between."""
    boxes_a, boxes_b = resample(a, times_a).boxes, resample(b, times_b).boxes
    reach = 0.5 * float(np.hypot(*boxes_a[:, SIZE_XY].T).max() + np.hypot(*boxes_b[:, SIZE_XY].T).max())
    on_path_a, on_path_b = _within(boxes_a, boxes_b, reach), _within(boxes_b, boxes_a, reach)
    times_a, boxes_a = times_a[on_path_a], boxes_a[on_path_a]
    times_b, boxes_b = times_b[on_path_b], boxes_b[on_path_b]
    first = np.searchsorted(times_b, times_a - int(max_pet_s * 1e9))
    last = np.searchsorted(times_b, times_a + int(max_pet_s * 1e9), side="right")
    width = int((last - first).max(initial=0))
    if width == 0:
        return None
    # Only the band of times that are close enough: column k of row i stands for b's moment first[i] + k.
    j = first[:, None] + np.arange(width)
    inside = j < last[:, None]
    j = np.minimum(j, len(times_b) - 1)
    offset = boxes_a[:, None, XY] - boxes_b[j, XY]
    row, column = np.nonzero(inside & (_squared(offset) <= reach**2))
    i, j = row, j[row, column]
    if min_heading_difference_rad > 0:
        differ = courses_differ(boxes_a, boxes_b, i, j, min_heading_difference_rad)
        i, j = i[differ], j[differ]
    touch = footprints_touch(boxes_a[i], boxes_b[j])
    if not touch.any():
        return None
    i, j = i[touch], j[touch]
    best = int(np.argmin(np.abs(times_a[i] - times_b[j])))
    return int(times_a[i[best]]), int(times_b[j[best]])


def paths_cross(a: Array, b: Array, least_rad: float) -> bool:
    """Whether two paths (N, 2) and (M, 2), m, cut each other at an angle of at least ``least_rad``.

    Who turns into a lane behind another, or leaves it before another, does not cross that one's path: such a pair
    follows.
    """
    a, b = _thinned(a), _thinned(b)
    if len(a) < 2 or len(b) < 2:
        return False
    u, v = np.diff(a, axis=0), np.diff(b, axis=0)
    offset = b[None, :-1] - a[:-1, None]
    # of all pairs of steps only those that lie near enough to each other
    reach = np.hypot(*u.T)[:, None] + np.hypot(*v.T)
    i, j = np.nonzero(_squared(offset) <= reach**2)
    u, v, offset = u[i], v[j], offset[i, j]
    area = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along_a = (offset[..., 0] * v[..., 1] - offset[..., 1] * v[..., 0]) / area
        along_b = (offset[..., 0] * u[..., 1] - offset[..., 1] * u[..., 0]) / area
    cut = (along_a >= 0) & (along_a <= 1) & (along_b >= 0) & (along_b <= 1)
    angle = np.abs(np.arctan2(area, (u * v).sum(axis=-1)))
    return bool((cut & (angle >= least_rad)).any())


def _squared(offset: Array) -> Array:
    """Squared lengths (...) of vectors (..., 2): several times faster than a sum over so short an axis."""
    return offset[..., 0] ** 2 + offset[..., 1] ** 2


def _thinned(path: Array) -> Array:
    """Places of a path (N, 2) that are at least `_STEP_M` of the way apart: standing still has no direction."""
    way = np.r_[0.0, np.cumsum(np.hypot(*np.diff(path, axis=0).T))]
    rows = np.searchsorted(way, np.arange(0.0, way[-1], _STEP_M))
    return path[rows[np.r_[True, np.diff(rows) > 0][: len(rows)]]]


def courses_differ(
    boxes_a: Array, boxes_b: Array, i: NDArray[np.int64], j: NDArray[np.int64], least_rad: float
) -> NDArray[np.bool_]:
    """(P,) whether two come to the places where they are at moments i of a and j of b (P,) on different courses.

    Of two that follow each other through a bend, the one ahead has turned farther, too. So not only their headings at
    these moments must differ, but also that of each when it passes nearest to where the other then is.

    Args:
        boxes_a: (N, 7) along one path.
        boxes_b: (M, 7) along the other.
        i: (P,) moments of a.
        j: (P,) moments of b.
        least_rad: of the difference.
    """
    place_a, yaw_a = boxes_a[:, XY], boxes_a[:, YAW]
    place_b, yaw_b = boxes_b[:, XY], boxes_b[:, YAW]
    # trees, since all gaps between two who stood for minutes before they drove would not fit into memory
    b_there, a_there = yaw_b[cKDTree(place_b).query(place_a)[1]], yaw_a[cKDTree(place_a).query(place_b)[1]]
    pairs = ((yaw_a[i], yaw_b[j]), (yaw_a[i], b_there[i]), (a_there[j], yaw_b[j]))
    return np.asarray(np.all([np.abs(normalise_angle(one - other)) >= least_rad for one, other in pairs], axis=0))


def _within(boxes: Array, others: Array, reach_m: float) -> NDArray[np.bool_]:
    """Which boxes (N, 7) lie within reach of the rectangle around all centres of the others (M, 7)."""
    low, high = others[:, :2].min(axis=0) - reach_m, others[:, :2].max(axis=0) + reach_m
    return np.asarray(((boxes[:, XY] >= low) & (boxes[:, XY] <= high)).all(axis=1))
