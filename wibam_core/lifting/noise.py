"""What the fits tell of the detector: how noisy its edges are, and for how long it errs in the same way."""

from __future__ import annotations

import numpy as np
import torch

from wibam_core.lifting.fit import Fit, FitProblem
from wibam_core.lifting.observations import Observations
from wibam_core.lifting.trajectory import Tracks

#: Fewer edges than this tell nothing.
_FEWEST_EDGES = 40
#: Residuals are cut off at this many standard deviations before they are correlated, so that wrong boxes do not decide.
_CLIP_SD = 3.0
_MOST_PERSISTENT = 0.95


def noise_of(problem: FitProblem, fitted: Fit) -> float:
    """How many times worse than assumed the edges are, by the residuals of fits that have edges to spare.

    The median is taken, so that wrong boxes do not count; 1 where there is too little to tell.
    """
    compared = fitted.residuals.isfinite().flatten(1)
    count = compared.sum(dim=1).to(fitted.residuals.dtype)
    prior = torch.diag_embed(problem.prior_weight + 1e-4)
    # degrees of freedom that a fit takes from its edges, which makes residuals smaller: trace of (data + prior)⁻¹ data
    used = torch.linalg.solve(fitted.information + prior, fitted.information).diagonal(dim1=1, dim2=2).sum(dim=1)
    spare = 1.0 - used / count.clamp_min(1.0)
    enough = compared & (spare > 0.2)[:, None]
    if int(enough.sum()) < _FEWEST_EDGES:
        return 1.0
    deviations = (fitted.residuals.flatten(1).abs() / spare.clamp_min(0.1).sqrt()[:, None])[enough]
    return float((1.4826 * deviations.median()).clamp(0.5, 5.0))


def persistence(tracks: Tracks, seen: Observations, fitted: Fit) -> float:
    """Correlation in [0, 0.95] of an edge's residual with the same camera's one sighting later."""
    residuals = np.clip(fitted.residuals.numpy().astype(np.float64), -_CLIP_SD, _CLIP_SD)
    by_camera = np.full((len(seen), int(seen.cameras.max(initial=0)) + 1, 4), np.nan)
    row, slot = np.nonzero(seen.seen)
    by_camera[row, seen.cameras[row, slot]] = residuals[row, slot]
    both = tracks.valid[:, 1:]
    now, later = by_camera[tracks.rows[:, :-1][both]], by_camera[tracks.rows[:, 1:][both]]
    pairs = np.isfinite(now) & np.isfinite(later)
    if pairs.sum() < _FEWEST_EDGES:
        return 0.0
    a, b = now[pairs], later[pairs]
    return float(np.clip((a @ b) / np.sqrt((a @ a) * (b @ b) + 1e-12), 0.0, _MOST_PERSISTENT))
