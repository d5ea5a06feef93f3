"""Where road users are followed well enough to say who came close to whom, and how much was driven there.

A cell of the ground is analysable where road users passed, their places are certain enough, and hardly any track begins
or ends: where road users come into view or are lost, those who are not seen would be missing from every count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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


def analysable_area(tracks: Sequence[Track], config: SafetyConfig) -> AnalysableArea:
    """The area of a recording with these tracks, those of one clock."""
    if not tracks:
        return AnalysableArea((0.0, 0.0), _CELL_M, np.zeros((1, 1), bool), 0.0, 0.0, 0.0)
    begin, end = min(int(t.times_ns[0]) for t in tracks), max(int(t.times_ns[-1]) for t in tracks)
    low = np.floor(np.min([t.boxes[:, XY].min(axis=0) for t in tracks], axis=0) / _CELL_M) * _CELL_M - _CELL_M
    high = np.max([t.boxes[:, XY].max(axis=0) for t in tracks], axis=0)
    shape = tuple((np.ceil((high - low) / _CELL_M).astype(int) + 2).tolist())
    states, variances, passed, lost = (np.zeros(shape) for _ in range(4))
    for track in tracks:
        cell = np.floor((track.boxes[:, XY] - low) / _CELL_M).astype(int)
        np.add.at(states, tuple(cell.T), 1.0)
        np.add.at(variances, tuple(cell.T), place_sd_m(track) ** 2)
        passed[tuple(np.unique(cell, axis=0).T)] += 1.0
        if track.times_ns[0] - begin > _CUT_S * 1e9:
            lost[tuple(cell[0])] += 1.0
        if end - track.times_ns[-1] > _CUT_S * 1e9:
            lost[tuple(cell[-1])] += 1.0
    around = [uniform_filter(grid, _AROUND, mode="constant") for grid in (states, variances, passed, lost)]
    # who passes through a neighbourhood is counted in each cell of the way: about as many as it is wide
    passes = around[2] * _AROUND
    seen = around[0] > 1e-9
    variance = np.where(seen, around[1] / np.maximum(around[0], 1e-9), np.inf)
    cells = seen & (np.sqrt(variance) <= config.max_place_sd_m)
    cells &= around[3] * _AROUND**2 <= _MAX_LOST * passes + 0.5
    near_way = uniform_filter(states, 3, mode="constant") > 1e-9
    cells = _without_specks(cells & near_way)
    area = AnalysableArea((float(low[0]), float(low[1])), _CELL_M, cells, (end - begin) / 3.6e12, 0.0, 0.0)
    hours = km = 0.0
    for track in tracks:
        inside = area.holds(track.boxes[:, XY])
        steps = inside[1:] & inside[:-1]
        hours += float(np.diff(track.times_ns)[steps].sum()) / 3.6e12
        km += float(np.hypot(*np.diff(track.boxes[:, XY], axis=0).T)[steps].sum()) / 1e3
    return AnalysableArea(area.origin_m, _CELL_M, cells, area.hours, hours, km)


def _without_specks(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    for filled in (False, True):  # first holes, then pieces
        count, labels, stats, _ = cv2.connectedComponentsWithStats((cells == filled).astype(np.uint8), connectivity=4)
        for number in range(1, count):
            if stats[number, cv2.CC_STAT_AREA] < _LEAST_CELLS:
                cells = np.where(labels == number, not filled, cells)
    return np.asarray(cells, bool)
