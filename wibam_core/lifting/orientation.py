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
#: Where nobody passes through its place, a vehicle is taken to be parked beside a lane whose middle is at most this far
#: away (m): most park as that lane drives, on its outer side. One in eight the other way is the doubt that is left, so
#: that no network is taught a front by it.
_BESIDE_M = 4.0
_BESIDE_SD_RAD = 1.1
#: Directions that differ by less than the angle with this cosine are the same, or, by half a turn, opposite.
_SAME_COS = 0.9
#: On which side traffic keeps is told by lanes of opposite directions up to this far apart (m), if so many places have
#: such a neighbour and at least this share of them on one side.
_OPPOSITE_M, _OPPOSITE_PLACES, _OPPOSITE_SHARE = 8.0, 20, 0.8
#: Traffic counts once in a square of this side (m) and an eighth of a turn.
_SQUARE_M = 2.0
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
    go that pass through the same place; else, with more doubt, where they go in the lane at whose outer side it stands.

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
    lanes = _Lanes.of(parameters[moving, PLACE], yaw[moving])
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
        along, doubt = 0.0, UNKNOWN_YAW_SD_RAD
        if flow is not None:
            place = np.median(parameters[own, PLACE], axis=0)
            near = flow.query_ball_point(place, _FLOW_RADIUS_M)
            along = float(np.cos(yaw[moving][near] - axis).sum())
            if abs(along) > _FLOW_VOTES:
                doubt = _FLOW_SD_RAD
            elif beside := lanes.direction_beside(place, axis):
                along, doubt = beside, _BESIDE_SD_RAD
        found.yaw_rad[own] = axis if along >= 0 else axis + np.pi
        found.front_sd_rad[own] = doubt
    return found


@dataclass(frozen=True, eq=False)
class _Lanes:
    """Where traffic goes: places (K, 2), m, and yaws (K,), rad, thinned out, and the side on which it keeps: 1 right,
    −1 left, 0 not known."""

    places: FloatArray
    yaw_rad: FloatArray
    keeps_right: int

    @classmethod
    def of(cls, places: FloatArray, yaw_rad: FloatArray) -> _Lanes:
        """Of sightings of vehicles that move."""
        squares = np.column_stack([np.floor(places / _SQUARE_M), np.round(yaw_rad / (np.pi / 4)) % 8])
        first = np.unique(squares, axis=0, return_index=True)[1]
        thinned = cls(places[first], yaw_rad[first], 0)
        sides = []
        for place, yaw in zip(thinned.places, thinned.yaw_rad, strict=True):
            left_m, cos = thinned._around(place, yaw, _OPPOSITE_M)
            opposite = left_m[cos < -_SAME_COS]
            if len(opposite):
                sides.append(np.sign(np.median(opposite)))
        clear = len(sides) >= _OPPOSITE_PLACES and abs(np.mean(sides)) >= 2 * _OPPOSITE_SHARE - 1
        return cls(thinned.places, thinned.yaw_rad, int(np.sign(np.mean(sides))) if clear else 0)

    def direction_beside(self, place: FloatArray, axis_rad: float) -> float:
        """1 if the lane at whose outer side the place (2,) lies goes along the axis, −1 if against it, 0 if there is
        none."""
        left_m, cos = self._around(place, axis_rad, _BESIDE_M)
        parallel = np.abs(cos) > _SAME_COS
        outside = parallel & (np.sign(left_m) * np.sign(cos) == self.keeps_right)
        return float(np.sign(cos[outside].sum())) if self.keeps_right and parallel.sum() == outside.sum() else 0.0

    def _around(self, place: FloatArray, yaw_rad: float, radius_m: float) -> tuple[FloatArray, FloatArray]:
        """How far to the left traffic lies whose place is within the radius, and the cosines of its direction, as seen
        from the place along ``yaw_rad``."""
        apart = self.places - place
        near = np.hypot(*apart.T) < radius_m
        left_m = apart[near] @ np.array([-np.sin(yaw_rad), np.cos(yaw_rad)])
        return left_m, np.cos(self.yaw_rad[near] - yaw_rad)
