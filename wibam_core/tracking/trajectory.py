"""From the boxes that belong to one vehicle to its smooth 7DoF track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import POSE, SIZE, YAW, Z
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import CLASSES
from wibam_core.scene import Track
from wibam_core.tracking.fusion import SD_FLOOR
from wibam_core.tracking.models import model_of
from wibam_core.tracking.motion import YAW as STATE_YAW
from wibam_core.tracking.motion import Belief, Measurement, MotionModel
from wibam_core.tracking.smoother import smooth

Array = NDArray[np.float64]

#: A vehicle that drove at least this far shows by its motion where its front is.
_MIN_DRIVEN_M = 2.0
#: A camera errs in much the same way in one frame and the next, while the smoother takes errors for independent: where
#: half of their variance persists, the smoother's variances are too small by about this factor
#: (benchmarks/tracking.py).
_CORRELATION = 3.0


@dataclass(frozen=True, eq=False)
class Hit:
    """A vehicle's fused box at one instant.

    Attributes:
        box, sd: (7,). votes: (C,) by class. headings: (2,) votes for the box's yaw and for the opposite one.
    """

    time_ns: int
    box: Array
    sd: Array
    votes: Array
    headings: Array


def to_track(track_id: int, hits: Sequence[Hit], instants: NDArray[np.int64]) -> Track:
    """Smooth one vehicle's boxes (in time order), with a state at each of the instants from the first to the last box.

    It has one size, the weighted median over time, and stands on the ground. Its front is where its motion says; for
    one that hardly moved, where most views saw it.
    """
    size, size_sd = _size(hits)
    road_user = CLASSES[int(np.argmax(np.sum([hit.votes for hit in hits], axis=0)))]
    model = model_of(road_user, float(size[0]))
    times = instants[(instants >= hits[0].time_ns) & (instants <= hits[-1].time_ns)]
    measured = {hit.time_ns: Measurement(hit.time_ns, hit.box[POSE], hit.sd[POSE]) for hit in hits}
    beliefs = smooth(model, times, measured)
    if _is_reversed(model, beliefs, times, hits):
        first = measured[int(times[0])]
        turned = np.array([*first.value[:2], beliefs[0].mean[STATE_YAW] + np.pi])
        beliefs = smooth(model, times, {**measured, first.time_ns: Measurement(first.time_ns, turned, first.sd)})
    n = len(times)
    boxes, sd = np.empty((n, 7)), np.empty((n, 7))
    velocities, yaw_rates = np.empty((n, 2)), np.empty(n)
    for k, belief in enumerate(beliefs):
        place, H = model.centre(belief)
        covariance = H @ belief.covariance @ H.T
        boxes[k] = [place[0], place[1], size[2] / 2, *size, normalise_angle(place[2])]
        sd[k, POSE] = np.sqrt(_CORRELATION * np.maximum(np.diag(covariance), 0.0))
        velocities[k], yaw_rates[k] = model.velocity(belief.mean)
    sd[:, Z], sd[:, SIZE] = size_sd[2] / 2, size_sd
    return Track(track_id, road_user, times, boxes, np.maximum(sd, SD_FLOOR / 3), velocities, yaw_rates)


def _size(hits: Sequence[Hit]) -> tuple[Array, Array]:
    """Weighted median of length, width and height (3,), and its standard deviation (3,)."""
    sizes = np.array([hit.box[SIZE] for hit in hits])
    weights = 1.0 / np.array([hit.sd[SIZE] for hit in hits]) ** 2
    order = np.argsort(sizes, axis=0)
    cumulative = np.cumsum(np.take_along_axis(weights, order, axis=0), axis=0)
    middle = (cumulative >= 0.5 * cumulative[-1]).argmax(axis=0)
    median = np.take_along_axis(sizes, order, axis=0)[middle, np.arange(3)]
    spread = 1.4826 * np.median(np.abs(sizes - median), axis=0)
    return median, np.hypot(spread / np.sqrt(len(hits)), SD_FLOOR[SIZE])


def _is_reversed(model: MotionModel, beliefs: Sequence[Belief], times: NDArray[np.int64], hits: Sequence[Hit]) -> bool:
    """Whether the smoothed yaw points to the vehicle's rear."""
    speeds = np.array([model.travel(belief.mean)[1] for belief in beliefs])
    driven = float(np.sum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times) * 1e-9))
    if abs(driven) >= _MIN_DRIVEN_M:
        return driven < 0
    along = 0.0
    yaws = dict(zip(times.tolist(), (belief.mean[STATE_YAW] for belief in beliefs), strict=True))
    for hit in hits:
        agrees = np.cos(hit.box[YAW] - yaws[hit.time_ns]) >= 0
        along += float(hit.headings[0] - hit.headings[1]) * (1.0 if agrees else -1.0)
    return along < 0
