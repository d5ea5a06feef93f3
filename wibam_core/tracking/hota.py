"""Higher-order tracking accuracy on ground-plane boxes.

Luiten et al., "HOTA: A Higher Order Metric for Evaluating Multi-Object Tracking", IJCV 2021, with the bird's-eye-view
IoU as similarity: for each threshold α, HOTA = √(DetA · AssA), where AssA averages over the matched boxes how well
the two tracks that were matched there agree over their whole length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from wibam_core.geometry.iou import bev_iou
from wibam_core.scene import Track

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

ALPHAS = np.arange(0.05, 0.99, 0.05)


@dataclass(frozen=True)
class Hota:
    """Means over the thresholds α = 0.05 … 0.95; all in [0, 1].

    Attributes:
        hota: the whole. det_a: detection. ass_a: association. loc_a: mean similarity of the matches.
        by_alpha: HOTA at each threshold.
    """

    hota: float
    det_a: float
    ass_a: float
    loc_a: float
    by_alpha: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _Instant:
    truth: Indices
    found: Indices
    similarity: Array


def hota(truth: Sequence[Track], found: Sequence[Track]) -> Hota:
    """HOTA of found tracks against true ones, over the instants (exact times) that either has.

    Both must be sampled at the same instants; a state at a time that the other never has is a miss or a false box.
    """
    instants = _instants(truth, found)
    true_lengths = np.array([len(track) for track in truth], dtype=np.float64)
    found_lengths = np.array([len(track) for track in found], dtype=np.float64)
    if not len(truth) or not len(found):
        return Hota(0.0, 0.0, 0.0, 0.0, (0.0,) * len(ALPHAS))
    alignment = _alignment(instants, true_lengths, found_lengths)
    pairs = np.zeros((len(ALPHAS), len(truth), len(found)))
    similarity_sum = np.zeros(len(ALPHAS))
    for instant in instants:
        score = alignment[np.ix_(instant.truth, instant.found)] * instant.similarity
        rows, columns = linear_sum_assignment(-score)
        similar = instant.similarity[rows, columns]
        hit = similar >= ALPHAS[:, None] - 1e-12
        pairs[:, instant.truth[rows], instant.found[columns]] += hit
        similarity_sum += (hit * similar).sum(axis=1)
    matches = pairs.sum(axis=(1, 2))
    det_a = matches / (true_lengths.sum() + found_lengths.sum() - matches)
    together = pairs / np.maximum(true_lengths[:, None] + found_lengths - pairs, 1.0)
    ass_a = (pairs * together).sum(axis=(1, 2)) / np.maximum(matches, 1.0)
    loc_a = np.where(matches > 0, similarity_sum / np.maximum(matches, 1.0), 0.0)
    by_alpha = np.sqrt(det_a * ass_a)
    return Hota(
        float(by_alpha.mean()),
        float(det_a.mean()),
        float(ass_a.mean()),
        float(loc_a.mean()),
        tuple(float(value) for value in by_alpha),
    )


def _instants(truth: Sequence[Track], found: Sequence[Track]) -> list[_Instant]:
    rows: dict[int, tuple[list[tuple[int, Array]], list[tuple[int, Array]]]] = {}
    for side, tracks in enumerate((truth, found)):
        for number, track in enumerate(tracks):
            for time, box in zip(track.times_ns.tolist(), track.boxes, strict=True):
                rows.setdefault(time, ([], []))[side].append((number, box))
    return [
        _Instant(
            np.array([n for n, _ in a], np.int64),
            np.array([n for n, _ in b], np.int64),
            bev_iou(np.array([box for _, box in a]), np.array([box for _, box in b])),
        )
        for _, (a, b) in sorted(rows.items())
        if a and b
    ]


def _alignment(instants: Sequence[_Instant], true_lengths: Array, found_lengths: Array) -> Array:
    """How well each true and each found track agree as a whole: the soft Jaccard index of their boxes."""
    potential = np.zeros((len(true_lengths), len(found_lengths)))
    for instant in instants:
        s = instant.similarity
        shared = s.sum(axis=0, keepdims=True) + s.sum(axis=1, keepdims=True) - s
        potential[np.ix_(instant.truth, instant.found)] += np.divide(s, shared, out=np.zeros_like(s), where=shared > 0)
    return potential / (true_lengths[:, None] + found_lengths - potential)
