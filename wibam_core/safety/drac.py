"""Deceleration rate to avoid the crash (DRAC)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: No road vehicle brakes harder: friction of about 1 on dry asphalt times 9.81 m/s². More cannot be avoided by braking.
MAX_BRAKING_MPS2 = 10.0


def deceleration_to_avoid(ttc_s: ArrayLike, velocities_a: ArrayLike, velocities_b: ArrayLike) -> Array:
    """Constant braking (...,) in m/s² that takes away the whole relative speed within the remaining distance.

    With a remaining distance of (relative speed · time to collision) that is relative speed / (2 · time to
    collision). Exact for a follower and for two that drive head on; for crossing paths it is that of both together.

    Args:
        ttc_s: (...,) times to collision; 0 gives inf, inf gives 0.
        velocities_a: (..., 2), m/s.
        velocities_b: (..., 2), m/s.
    """
    closing = np.linalg.norm(np.asarray(velocities_a, dtype=np.float64) - np.asarray(velocities_b), axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(closing == 0, 0.0, closing / (2.0 * np.asarray(ttc_s, dtype=np.float64)))
