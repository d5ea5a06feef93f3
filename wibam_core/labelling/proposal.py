"""What a person starts labelling an instant from: the job's own fits, which are still to be looked at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wibam_core.documents.hand_labels import HandVehicle
from wibam_core.geometry.box3d import YAW
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import CLASSES
from wibam_core.scene import FloatArray, IntArray, Vehicles3D

#: Between fits of one vehicle at most this far apart, it is taken to move evenly.
_MAX_GAP_NS = 1_500_000_000


def proposed(fits: Sequence[Vehicles3D], time_ns: int) -> list[HandVehicle]:
    """The vehicles that were fitted at a time, or around it, moved there.

    Args:
        fits: ids are track ids.
        time_ns: the instant.

    Returns:
        In the order of their ids, with the velocity that the fits before and after them say.
    """
    near = [fit for fit in fits if abs(fit.time_ns - time_ns) <= _MAX_GAP_NS]
    found = []
    for track_id in sorted({int(id_) for fit in near for id_ in fit.ids if id_ >= 0}):
        times, boxes, classes = _of_track(near, track_id)
        after = int(np.searchsorted(times, time_ns))
        exact = after < len(times) and times[after] == time_ns
        if not exact and not 0 < after < len(times):
            continue
        box = boxes[after] if exact else _between(times, boxes, after, time_ns)
        first, last = max(after - 1, 0), min(after + exact, len(times) - 1)
        lasts_s = (times[last] - times[first]) * 1e-9
        velocity = (boxes[last, :2] - boxes[first, :2]) / lasts_s if lasts_s > 0 else np.zeros(2)
        found.append(
            HandVehicle(
                id=track_id,
                vehicle_class=CLASSES[int(classes[min(after, len(times) - 1)])],
                box=tuple(box.tolist()),
                velocity_mps=(float(velocity[0]), float(velocity[1])),
            )
        )
    return found


def _of_track(fits: Sequence[Vehicles3D], track_id: int) -> tuple[IntArray, FloatArray, IntArray]:
    rows = [(fit, int(np.flatnonzero(fit.ids == track_id)[0])) for fit in fits if (fit.ids == track_id).any()]
    rows.sort(key=lambda one: one[0].time_ns)
    times = np.array([fit.time_ns for fit, _ in rows], np.int64)
    return times, np.array([fit.boxes[row] for fit, row in rows]), np.array([fit.classes[row] for fit, row in rows])


def _between(times: IntArray, boxes: FloatArray, after: int, time_ns: int) -> FloatArray:
    a, b = boxes[after - 1], boxes[after]
    share = (time_ns - times[after - 1]) / (times[after] - times[after - 1])
    box = a + share * (b - a)
    box[YAW] = normalise_angle(a[YAW] + share * normalise_angle(b[YAW] - a[YAW]))
    return np.asarray(box)
