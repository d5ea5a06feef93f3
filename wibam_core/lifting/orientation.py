"""Headings of vehicles that are never seen to move: an axis from their fits, a front from the traffic around them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from wibam_core.lifting.fit import PLACE, YAW
from wibam_core.lifting.trajectory import Tracks
from wibam_core.scene import FloatArray

#: Standard deviation of a yaw whose front may as well be its rear.
UNKNOWN_YAW_SD_RAD = np.pi / 2
#: Vehicles that pass within this distance of a standing one tell by their directions where its front is.
_FLOW_RADIUS_M = 2.0
#: They are believed if their votes for one end outnumber those for the other by more than this, with what doubt is
#: left.
_FLOW_VOTES = 3.0
_FLOW_SD_RAD = 0.5
#: The axis of a standing vehicle is never believed to be more certain than this.
_AXIS_FLOOR_RAD = 0.03


@dataclass(frozen=True, eq=False)
class StandingHeadings:
    """For observations (N,): yaw, s.d. of its axis, and s.d. that the doubt about front and rear adds (rad)."""

    yaw_rad: FloatArray
    axis_sd_rad: FloatArray
    front_sd_rad: FloatArray


def standing_headings(
    tracks: Tracks,
    parameters: FloatArray,
    covariance: FloatArray,
    yaw: FloatArray,
    yaw_sd: FloatArray,
) -> StandingHeadings:
    """Headings of the tracks without any motion; other observations keep a yaw of 0 and are not to be used.

    The axis is the mean direction, modulo half a turn, of the track's fits. The front is where vehicles
    go that pass through the same place.

    Args:
        tracks: how the observations form tracks.
        parameters: (N, 6) single fits.
        covariance: (N, 6, 6) of them.
        yaw: (N,) by motion.
        yaw_sd: (N,) of it, infinite for tracks that never move.
    """
    n = len(yaw)
    found = StandingHeadings(np.zeros(n), np.full(n, UNKNOWN_YAW_SD_RAD), np.full(n, UNKNOWN_YAW_SD_RAD))
    moving = np.isfinite(yaw_sd)
    flow = cKDTree(parameters[moving, PLACE]) if moving.any() else None
    for rows, valid in zip(tracks.rows, tracks.valid, strict=True):
        own = rows[valid]
        if moving[own].any():
            continue
        weight = 1.0 / (covariance[own, YAW, YAW] + _AXIS_FLOOR_RAD**2)
        doubled = np.sum(weight * np.exp(2j * parameters[own, YAW])) / weight.sum()
        axis = 0.5 * np.angle(doubled)
        # of independent directions with resultant length R the mean's doubled angle spreads as √(−2 ln R)
        spread = 0.5 * np.sqrt(-2 * np.log(np.clip(abs(doubled), 1e-3, 1 - 1e-9)))
        found.axis_sd_rad[own] = np.hypot(spread, _AXIS_FLOOR_RAD)
        if flow is not None:
            near = flow.query_ball_point(np.median(parameters[own, PLACE], axis=0), _FLOW_RADIUS_M)
            along = float(np.cos(yaw[moving][near] - axis).sum())
            doubt = _FLOW_SD_RAD if abs(along) > _FLOW_VOTES else UNKNOWN_YAW_SD_RAD
        else:
            along, doubt = 0.0, UNKNOWN_YAW_SD_RAD
        found.yaw_rad[own] = axis if along >= 0 else axis + np.pi
        found.front_sd_rad[own] = doubt
    return found
