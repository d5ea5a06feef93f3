"""Labels at the very moment a frame was exposed.

A frame belongs to an instant but was exposed up to half a frame interval before or after it: at 15 m/s and 40 ms that
is 0.6 m, more than the error that is to be measured.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wibam_core.geometry.box3d import XY, YAW
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.scene import LabelledInstant, Vehicles3D

#: Labels this close are taken as they are.
EXACT_NS = 1_000_000
#: Between labels at most this far apart a vehicle's state is interpolated.
MAX_GAP_NS = 200_000_000
#: Labels without a neighbour to interpolate with are taken up to this far: moved, where their velocity is known.
NEAREST_NS = 40_000_000


class LabelTimeline:
    """Labels by time.

    Args:
        labels: one entry per labelled instant, in any order.
    """

    def __init__(self, labels: Sequence[LabelledInstant]) -> None:
        self._labels = sorted(labels, key=lambda label: label.vehicles.time_ns)
        self._times = [label.vehicles.time_ns for label in self._labels]

    def __len__(self) -> int:
        return len(self._labels)

    def between(self, first_ns: int, last_ns: int) -> int:
        """How many labelled instants lie in the closed interval."""
        return bisect_right(self._times, last_ns) - bisect_left(self._times, first_ns)

    def distance_ns(self, time_ns: int) -> int:
        """To the nearest labelled instant; there must be one."""
        return min(abs(labelled - time_ns) for labelled in self._times)

    def at(self, time_ns: int) -> LabelledInstant | None:
        """Labels at ``time_ns``, or None where nothing was labelled.

        A vehicle that only one of the two neighbouring instants has, or that has no id, cannot be interpolated: it
        stays where it was labelled, with visibility 0, so that it is neither asked for nor held against a detector.
        """
        after = bisect_left(self._times, time_ns)
        near = [k for k in (after - 1, after) if 0 <= k < len(self._times)]
        if not near:
            return None
        nearest = min(near, key=lambda k: abs(self._times[k] - time_ns))
        distance = abs(self._times[nearest] - time_ns)
        if distance <= EXACT_NS:
            return self._labels[nearest]
        if len(near) == 2 and self._times[after] - self._times[after - 1] <= MAX_GAP_NS:
            return _between(self._labels[after - 1], self._labels[after], time_ns)
        return _moved(self._labels[nearest], time_ns) if distance <= NEAREST_NS else None


def _moved(label: LabelledInstant, time_ns: int) -> LabelledInstant:
    boxes = label.vehicles.boxes.copy()
    boxes[:, XY] += np.nan_to_num(label.velocities_mps) * (time_ns - label.vehicles.time_ns) * 1e-9
    return replace(label, vehicles=replace(label.vehicles, time_ns=time_ns, boxes=boxes))


def _between(first: LabelledInstant, second: LabelledInstant, time_ns: int) -> LabelledInstant:
    a, b = first.vehicles, second.vehicles
    share = (time_ns - a.time_ns) / (b.time_ns - a.time_ns)
    rows_b = {int(i): row for row, i in enumerate(b.ids) if i >= 0}
    pairs = [(row, rows_b[int(i)]) for row, i in enumerate(a.ids) if int(i) in rows_b]
    i = np.array([p for p, _ in pairs], np.int64)
    j = np.array([q for _, q in pairs], np.int64)
    boxes = a.boxes[i] + share * (b.boxes[j] - a.boxes[i])
    boxes[:, YAW] = normalise_angle(a.boxes[i, YAW] + share * normalise_angle(b.boxes[j, YAW] - a.boxes[i, YAW]))
    alone_a = np.setdiff1d(np.arange(len(a)), i)
    alone_b = np.setdiff1d(np.arange(len(b)), j)
    visibility = {}
    for camera in sorted({*first.visibility, *second.visibility}):
        seen_a = np.asarray(first.visibility.get(camera, np.zeros(len(a))))[i]
        seen_b = np.asarray(second.visibility.get(camera, np.zeros(len(b))))[j]
        alone = np.zeros(len(alone_a) + len(alone_b))
        visibility[camera] = np.concatenate([seen_a + share * (seen_b - seen_a), alone])
    return LabelledInstant(
        Vehicles3D.of(
            time_ns,
            np.concatenate([boxes, a.boxes[alone_a], b.boxes[alone_b]]),
            np.concatenate([a.classes[i], a.classes[alone_a], b.classes[alone_b]]),
            np.concatenate([a.ids[i], a.ids[alone_a], b.ids[alone_b]]),
        ),
        visibility,
        do_not_care=(*first.do_not_care, *second.do_not_care),
    )
