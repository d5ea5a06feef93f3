"""By how much a detector sets all edges of its boxes too far out or in: learned from all tracks at a site.

Detectors have habits: the pictures that they learned from were drawn or labelled otherwise than a site's cameras see. A
third of a pixel is nothing in the image; on the ground, 50 m from a camera 8 m up, it is a third of a metre, and the
same for all vehicles there. Such an offset is told apart from a wrong size or body, since in pixels these shrink with
the distance and an offset does not. Sizes and bodies of all vehicles are free, and marginalised.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from wibam_core.lifting.fit import FitProblem, fit, with_bodies
from wibam_core.lifting.shapes import MODE_SD, OFFSETS, Shapes, about_their_mean, marginal, of_tracks, sample_sightings
from wibam_core.lifting.trajectory import Tracks
from wibam_core.road_users import BODIES, LOG_SIZE_SD
from wibam_core.scene import FloatArray, IntArray

#: Standard deviation of an offset before looking, px.
_SD_PX = 0.5
#: Offsets are known no better than this, px: what fits leave in their last digits changes nothing.
_STEP_PX = 0.01
#: Vehicles are fitted beside the offsets, and offsets beside the vehicles, this many times in turn.
_ROUNDS = 2
#: Fewer tracks in several views tell nothing.
_FEWEST_TRACKS = 8


@dataclass(frozen=True, eq=False)
class EdgeOffsets:
    """What is to be taken off edges.

    Attributes:
        px: (4,) of left, top, right and bottom: how much farther right or down than the vehicles' they lie.
        sd_px: (4,) standard deviations.
        tracks: from how many tracks; 0 where there were too few, or where boxes fit no better without an offset.
    """

    px: FloatArray
    sd_px: FloatArray
    tracks: int

    @classmethod
    def unknown(cls) -> EdgeOffsets:
        """None that is known of."""
        return cls(np.zeros(4), np.full(4, _SD_PX), 0)

    def taken_off(self, problem: FitProblem) -> FitProblem:
        """The same problem with edges where they would be without."""
        return replace(problem, boxes=problem.boxes - torch.as_tensor(self.px, dtype=problem.boxes.dtype))


def learn_edge_offsets(
    problem: FitProblem,
    classes: IntArray,
    tracks: Tracks,
    usable: np.ndarray,
    *,
    iterations: int,
) -> EdgeOffsets:
    """Estimate the offsets that all edges of a site share.

    Args:
        problem: N vehicles at instants; their bodies are not read.
        classes: (N,) class indices, equal within a track.
        tracks: how the vehicles form tracks.
        usable: (N,) bool: seen by several cameras, and with a heading that is known.
        iterations: most steps of a fit.
    """
    found = EdgeOffsets.unknown()
    rows, track = sample_sightings(tracks, usable, classes, 1)
    count = len(np.unique(track))
    if count < _FEWEST_TRACKS:
        return found
    own = classes[rows]
    chosen = with_bodies(problem[torch.as_tensor(rows)], BODIES[own])
    fitted = fit(chosen, chosen.prior_mean[:, None], iterations)
    unexplained = float(fitted.cost.sum())
    for _ in range(_ROUNDS):
        at = found.taken_off(chosen)
        information, score, of_class = of_tracks(Shapes.unlearned(), at, fitted, own, track)
        px, sd_px = _of_all(information, score, of_class, found.px)
        found = EdgeOffsets(px, sd_px, count)
        fitted = fit(found.taken_off(chosen), fitted.parameters[:, None], iterations)
    left = float(fitted.cost.sum()) + 0.5 * float(((found.px / _SD_PX) ** 2).sum())
    return found if left < unexplained else EdgeOffsets.unknown()


def _of_all(
    information: FloatArray, score: FloatArray, classes: IntArray, before_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Offsets (4,) and their s.d. (4,) of the information (M, S, S) of tracks and its score (M, S), where
    ``before_px`` (4,) have been taken off: each class has its own mean size and body, all have the same offsets."""
    total, pull = np.eye(4) / _SD_PX**2, -before_px / _SD_PX**2
    for c in np.unique(classes):
        own = classes == c
        known = np.concatenate([LOG_SIZE_SD[c], MODE_SD]) ** -2.0
        spread = np.diag(np.concatenate([1 / known, np.zeros(4)]))
        prior = np.diag(np.concatenate([known, np.full(4, _SD_PX**-2.0)]))
        of, toward = about_their_mean(information[own], score[own], spread, prior)
        whole, sum_ = of.sum(axis=0), toward.sum(axis=0)
        free = whole[:OFFSETS, :OFFSETS] + np.diag(known)
        left, gained = marginal(
            whole[None, OFFSETS:, OFFSETS:], sum_[None, OFFSETS:], whole[None, OFFSETS:, :OFFSETS], free[None],
            sum_[None, :OFFSETS],
        )  # fmt: skip
        total, pull = total + left[0], pull + gained[0]
    covariance = np.linalg.inv(total)
    found_px = np.round((before_px + covariance @ pull) / _STEP_PX) * _STEP_PX
    return np.asarray(found_px), np.sqrt(np.diagonal(covariance))
