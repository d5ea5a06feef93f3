"""Clocks from the few light changes of a minute: simulated sites, whose clocks are known."""

import numpy as np

from benchmarks.synchronisation import Options, judged, simulated
from wibam_core.sync.witnesses import synchronise

#: Recordings of a minute in which an actuated signal changes some six times, four cameras.
MINUTE = Options(seconds=60.0, max_offset_s=40.0, jitter_s=6.0)
#: Two cameras this far apart, s, were put together by another cycle of the lights, which is another matter.
OTHER_CYCLE_S = 0.1


def test_with_few_light_changes_all_clocks_of_a_site_lie_within_two_standard_deviations():
    """They did in 84 % before few changes were taken to say little of their own errors."""
    within = []
    for seed in range(200, 250):
        witnesses = simulated(MINUTE, seed, with_traffic=False)
        changes = {camera_id: witness.changes for camera_id, witness in witnesses.items()}
        found = synchronise({c: witness.span_s for c, witness in witnesses.items()}, "cam1", changes=changes)
        worst_s, _, scaled = judged(found.result, witnesses)
        if worst_s < OTHER_CYCLE_S:
            within.append(np.abs(scaled).max() < 2.0)
    assert len(within) >= 35
    assert np.mean(within) >= 0.9
