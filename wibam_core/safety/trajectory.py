"""A track's state at any time between its first and last instant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import YAW
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.scene import Track

Array = NDArray[np.float64]


def resample(track: Track, times_ns: NDArray[np.int64]) -> Track:
    """The track at ``times_ns`` (strictly increasing), linear between instants; the yaw takes the shorter way.

    Times outside the track take its first or last state.
    """
    offset_s = (track.times_ns - track.times_ns[0]) * 1e-9
    at = (np.asarray(times_ns, dtype=np.int64) - track.times_ns[0]) * 1e-9

    def along(values: Array) -> Array:
        return np.stack([np.interp(at, offset_s, column) for column in values.T], axis=1)

    boxes = along(np.column_stack([track.boxes[:, :YAW], np.unwrap(track.boxes[:, YAW])]))
    boxes[:, YAW] = normalise_angle(boxes[:, YAW])
    return replace(
        track,
        times_ns=np.asarray(times_ns, dtype=np.int64),
        boxes=boxes,
        sd=along(track.sd),
        velocities_mps=along(track.velocities_mps),
        yaw_rates_radps=np.interp(at, offset_s, track.yaw_rates_radps),
    )
