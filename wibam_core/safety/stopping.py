"""Whether there is room left to stop (proportion of stopping distance)."""

from __future__ import annotations

import numpy as np

from wibam_core.safety.encounter import Encounter, Measure

#: Braking that most drivers manage, on wet roads too: that of stopping sight distances (AASHTO 2018).
_BRAKING_MPS2 = 3.4


def stopping_share(encounter: Encounter) -> float:
    """Way left to the collision, as a share of the way that stopping takes, of the one that has less.

    Allen, Shin & Cooper (1978): the way left is v·TTC, the way that stopping takes v²/(2·a).

    Returns:
        below 1 where braking by 3.4 m/s² alone is too late; inf where no collision is foreseen or both stand.
    """
    speeds_mps = np.hypot(*encounter.velocities_mps.T)
    fastest = float(speeds_mps.max())
    return 2 * _BRAKING_MPS2 * encounter.ttc_s / fastest if fastest > 0 else np.inf


STOPPING_SHARE = Measure(
    "stopping_share",
    "PSD",
    f"the way left to the collision over the way that stopping takes at {_BRAKING_MPS2:g} m/s²; below 1, who brakes "
    "like that comes to a stop too late",
    2,
    stopping_share,
)
