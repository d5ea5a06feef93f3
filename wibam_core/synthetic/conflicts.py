"""Where routes meet: zones that two vehicles must not use at the same time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.distance import cdist

from wibam_core.synthetic.routes import Route

#: Paths closer than this cannot be driven side by side, m.
_CLEARANCE_M = 2.9
_SAMPLE_M = 1.0


@dataclass(frozen=True)
class Zone:
    """What route ``own`` shares with another.

    Attributes:
        kind: "follow" where both come in on one lane and part in the zone's end, "cross", or "merge" where both leave
            on one lane.
        start_m, end_m: extent along the own route.
        other_start_m, other_end_m: extent along the other route.
        to_exit_m: for "merge": own distance minus the other's, of points side by side behind the merge.
    """

    kind: Literal["follow", "cross", "merge"]
    start_m: float
    end_m: float
    other_start_m: float
    other_end_m: float
    to_exit_m: float = 0.0


def find_zones(routes: Sequence[Route]) -> dict[tuple[int, int], Zone]:
    """Zones by (own route, other route); pairs that never meet are absent."""
    samples = []
    for route in routes:
        s = np.arange(route.stop_s_m - 1.0, route.box_s_m[1] + 12.0, _SAMPLE_M)
        samples.append((s, route.position(s)))
    zones = {}
    for i, one in enumerate(routes):
        for j, two in enumerate(routes):
            zone = _zone(one, two, *samples[i], *samples[j])
            if zone is not None:
                zones[i, j] = zone
    return zones


def _zone(
    one: Route, two: Route, s_one: np.ndarray, p_one: np.ndarray, s_two: np.ndarray, p_two: np.ndarray
) -> Zone | None:
    same_lane = one.incoming is two.incoming and one.lane == two.lane
    same_exit = one.outgoing is two.outgoing and one.exit_lane == two.exit_lane
    if one is two:
        return Zone("follow", 0.0, one.length_m, 0.0, one.length_m)
    close = cdist(p_one, p_two) < _CLEARANCE_M
    if not close.any():
        return None
    on_one, on_two = np.flatnonzero(close.any(axis=1)), np.flatnonzero(close.any(axis=0))
    if same_lane:
        # the zone ends where the paths part for good
        apart = np.flatnonzero(~close.any(axis=1))
        end = s_one[apart[0]] if len(apart) else s_one[-1]
        apart = np.flatnonzero(~close.any(axis=0))
        return Zone("follow", 0.0, float(end), 0.0, float(s_two[apart[0]] if len(apart) else s_two[-1]))
    if same_exit:
        return Zone(
            "merge",
            float(s_one[on_one[0]]),
            one.length_m,
            float(s_two[on_two[0]]),
            two.length_m,
            one.length_m - two.length_m,
        )
    if one.incoming is two.incoming:
        return None  # neighbouring lanes of one arm: their turns lie beside each other
    return Zone(
        "cross", float(s_one[on_one[0]]), float(s_one[on_one[-1]]), float(s_two[on_two[0]]), float(s_two[on_two[-1]])
    )
