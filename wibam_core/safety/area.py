"""Where road users are followed well enough to say who came close to whom, and how much was driven there.

A cell of the ground is analysable where road users passed, their places are certain enough, and hardly any track begins
or ends: where road users come into view or are lost, those who are not seen would be missing from every count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from wibam_core.config import SafetyConfig
from wibam_core.geometry.box3d import XY
from wibam_core.safety.track_errors import place_sd_m
from wibam_core.scene import Track

Array = NDArray[np.float64]

_CELL_M = 2.0
#: Cells are judged with those around them, so many a side.
_AROUND = 5
#: Of those who pass there, no more than this share may come into view or be lost.
_MAX_LOST = 0.25
#: A track that begins or ends within this of the recording's begin or end is cut by it.
_CUT_S = 1.0
#: What lies farther than this from the middle of all that was seen is nobody's place, m: it bounds the area.
_REACH_M = 500.0
#: Pieces and holes smaller than so many cells are none.
_LEAST_CELLS = 6


@dataclass(frozen=True, eq=False)
class AnalysableArea:
    """Part of the ground, and what was seen there.

    Attributes:
        origin_m: x and y of the corner of cell (0, 0). cell_m: its side.
        cells: (X, Y) whether a cell belongs to it.
        hours: that were recorded. road_user_hours, road_user_km: spent and gone there by all road users.
    """

    origin_m: tuple[float, float]
    cell_m: float
    cells: NDArray[np.bool_]
    hours: float
    road_user_hours: float
    road_user_km: float

    @property
    def area_m2(self) -> float:
        return float(self.cells.sum()) * self.cell_m**2

    def holds(self, places: Array) -> NDArray[np.bool_]:
        """(N,) whether places (N, 2) in m lie in it."""
        cell = np.floor((places - np.array(self.origin_m)) / self.cell_m).astype(np.int64)
        inside = ((cell >= 0) & (cell < self.cells.shape)).all(axis=1)
        held = np.zeros(len(places), bool)
        held[inside] = self.cells[tuple(cell[inside].T)]
        return held

    def used_by(
        self, tracks: Sequence[Track], start_ns: int | None = None, end_ns: int | None = None
    ) -> AnalysableArea:
        """The area with what these tracks spent and went in it, from a time on until before another, added."""
        hours, km = self.road_user_hours, self.road_user_km
        for track in tracks:
            first, last = _rows(track, start_ns, end_ns)
            last = min(last + 1, len(track))  # the step to the state after these belongs to them
            inside = self.holds(track.boxes[first:last, XY])
            steps = inside[1:] & inside[:-1]
            hours += float(np.diff(track.times_ns[first:last])[steps].sum()) / 3.6e12
            km += float(np.hypot(*np.diff(track.boxes[first:last, XY], axis=0).T)[steps].sum()) / 1e3
        return replace(self, road_user_hours=hours, road_user_km=km)

    def outlines(self) -> list[list[tuple[float, float]]]:
        """Rings of x, y in m around it and around its holes, without the first corner again at the end."""
        # twice as fine, so that a contour, which runs through the middle of cells, keeps to their sides
        fine = np.kron(np.pad(self.cells, 1).astype(np.uint8), np.ones((2, 2), np.uint8))
        found, _ = cv2.findContours(fine, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        rings = []
        for contour in found:
            # OpenCV's points are (column, row), here (y, x); a half-cell's middle lies a quarter of a cell off
            points = (contour[:, 0, ::-1] / 2 + 0.25 - 1.0) * self.cell_m + np.array(self.origin_m)
            rings.append([(round(float(x), 2), round(float(y), 2)) for x, y in points])
        return rings


class SeenGround:
    """What tracks say of the ground, taken in stretch by stretch: it grows with the ground, not with the footage.

    Args:
        recorded_ns: (first, last) times of each piece of footage, ascending. Tracks that are cut by its begin or end
            are not lost there.
    """

    def __init__(self, recorded_ns: Sequence[tuple[int, int]]) -> None:
        self._begins, self._ends = np.array(recorded_ns, np.int64).reshape(-1, 2).T
        #: (N, 2) cells, and (N, 4) of each: states, their summed variance, tracks, tracks that begin or end there.
        self._cells, self._sums = np.empty((0, 2), np.int64), np.empty((0, 4))

    def see(self, tracks: Sequence[Track], start_ns: int | None = None, end_ns: int | None = None) -> None:
        """Take in what tracks did from a time on until before another; None: all.

        Of tracks that go on beyond these times at least one state there must be given, too.
        """
        cells, sums = [self._cells], [self._sums]
        for track in tracks:
            first, last = _rows(track, start_ns, end_ns)
            if first == last:
                continue
            cell = np.floor(track.boxes[first:last, XY] / _CELL_M).astype(np.int64)
            own, of = np.unique(cell, axis=0, return_inverse=True)
            of = of.reshape(-1)
            counts = np.zeros((len(own), 4))
            np.add.at(counts[:, 0], of, 1.0)
            np.add.at(counts[:, 1], of, place_sd_m(track)[first:last] ** 2)
            counts[:, 2] = 1.0
            counts[of[0], 3] += first == 0 and self._is_inside(int(track.times_ns[0]))
            counts[of[-1], 3] += last == len(track) and self._is_inside(int(track.times_ns[-1]))
            cells.append(own)
            sums.append(counts)
        self._cells, of = np.unique(np.concatenate(cells), axis=0, return_inverse=True)
        every = np.concatenate(sums)
        self._sums = np.stack([np.bincount(of.reshape(-1), column, len(self._cells)) for column in every.T], axis=1)

    def _is_inside(self, time_ns: int) -> bool:
        """Whether a piece of footage lasts from well before a time until well after it."""
        cut_ns = int(_CUT_S * 1e9)
        return bool(((self._begins < time_ns - cut_ns) & (time_ns + cut_ns < self._ends)).any())

    def area(self, config: SafetyConfig) -> AnalysableArea:
        """The area, as far as it is known now; nobody has spent any time there yet."""
        hours = float((self._ends - self._begins).sum()) / 3.6e12
        if not len(self._cells):
            return AnalysableArea((0.0, 0.0), _CELL_M, np.zeros((1, 1), bool), hours, 0.0, 0.0)
        order = np.argsort(self._cells, axis=0)
        weights = np.cumsum(np.take_along_axis(self._sums[:, :1], order, axis=0), axis=0)
        half = (weights >= 0.5 * weights[-1]).argmax(axis=0)
        middle = np.take_along_axis(self._cells, order, axis=0)[half, [0, 1]]
        near = (np.abs(self._cells - middle) <= _REACH_M / _CELL_M).all(axis=1)
        low = self._cells[near].min(axis=0) - 1
        grids = np.zeros((4, *(self._cells[near].max(axis=0) - low + 2)))
        grids[:, *(self._cells[near] - low).T] = self._sums[near].T
        states = grids[0]
        around = [uniform_filter(grid, _AROUND, mode="constant") for grid in grids]
        # who passes through a neighbourhood is counted in each cell of the way: about as many as it is wide
        passes = around[2] * _AROUND
        seen = around[0] > 1e-9
        variance = np.where(seen, around[1] / np.maximum(around[0], 1e-9), np.inf)
        cells = seen & (np.sqrt(variance) <= config.max_place_sd_m)
        cells &= around[3] * _AROUND**2 <= _MAX_LOST * passes + 0.5
        near_way = uniform_filter(states, 3, mode="constant") > 1e-9
        x, y = (low * _CELL_M).tolist()
        return AnalysableArea((x, y), _CELL_M, _without_specks(cells & near_way), hours, 0.0, 0.0)


def analysable_area(tracks: Sequence[Track], config: SafetyConfig) -> AnalysableArea:
    """The area of a recording with these tracks, those of one clock."""
    times = [(int(t.times_ns[0]), int(t.times_ns[-1])) for t in tracks]
    ground = SeenGround([(min(first for first, _ in times), max(last for _, last in times))] if times else [])
    ground.see(tracks)
    return ground.area(config).used_by(tracks)


def _rows(track: Track, start_ns: int | None, end_ns: int | None) -> tuple[int, int]:
    """The first state from a time on, and the first from another on; None: all."""
    first = 0 if start_ns is None else int(np.searchsorted(track.times_ns, start_ns))
    return first, len(track) if end_ns is None else int(np.searchsorted(track.times_ns, end_ns))


def _without_specks(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    for filled in (False, True):  # first holes, then pieces
        count, labels, stats, _ = cv2.connectedComponentsWithStats((cells == filled).astype(np.uint8), connectivity=4)
        for number in range(1, count):
            if stats[number, cv2.CC_STAT_AREA] < _LEAST_CELLS:
                cells = np.where(labels == number, not filled, cells)
    return np.asarray(cells, bool)
