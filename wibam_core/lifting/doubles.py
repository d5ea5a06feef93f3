"""Two fits in one place are one vehicle that was associated as two, such as front and rear of a long one."""

from __future__ import annotations

import numpy as np

from wibam_core.geometry.box3d import LENGTH, WIDTH
from wibam_core.geometry.iou import bev_intersection_paired
from wibam_core.road_users import VULNERABLE
from wibam_core.scene import FloatArray, IntArray

#: Share of the smaller of two footprints that the other may cover. Fits of neighbours err by less than this.
_MAX_SHARED = 0.3


def doubled(
    boxes: FloatArray, classes: IntArray, instants: IntArray, tracks: IntArray, scores: FloatArray
) -> np.ndarray:
    """Which fits stand in that of another vehicle at the same instant.

    Of two, the one of the track with the larger sum of scores stays, at all instants: it was seen for longer, by more
    cameras or more exactly. Who walks or rides may be close to others, and is never left out.

    Args:
        boxes: (N, 7) fits.
        classes: (N,) indices into `wibam_core.road_users.CLASSES`.
        instants: (N,) number of the instant of each.
        tracks: (N,) number of the vehicle of each.
        scores: (N,) confidence.

    Returns:
        (N,) whether each is to be left out.
    """
    out = np.zeros(len(boxes), dtype=bool)
    if not len(boxes):
        return out
    names, track = np.unique(tracks, return_inverse=True)
    support = np.bincount(track, weights=scores, minlength=len(names))
    area = boxes[:, LENGTH] * boxes[:, WIDTH]
    candidates = np.flatnonzero(~VULNERABLE[classes])
    for instant in np.unique(instants[candidates]):
        rows = candidates[instants[candidates] == instant]
        first, second = (rows[index] for index in np.triu_indices(len(rows), 1))
        shared = bev_intersection_paired(boxes[first], boxes[second]) / np.minimum(area[first], area[second])
        together = shared > _MAX_SHARED
        ranked = [
            sorted(pair, key=lambda row: (-support[track[row]], names[track[row]]))
            for pair in zip(first[together].tolist(), second[together].tolist(), strict=True)
        ]
        # the best supported first, so that who gives way to a fit that is left out itself stays
        for kept, weaker in sorted(ranked, key=lambda pair: (-support[track[pair[0]]], names[track[pair[0]]])):
            out[weaker] |= not out[kept]
    return out
