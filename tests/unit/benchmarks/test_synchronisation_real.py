"""Whether late stamps are those of exposures: a vehicle whose way is known, in frames whose stamps are made here."""

import numpy as np
import pytest

from benchmarks.synchronisation_real import late_frames, tell_stamps
from wibam_core.scene import Detections2D

LATE = {20: 0.09, 33: 0.06, 47: 0.12, 61: 0.05, 72: 0.1, 84: 0.07}


def frames(*, exposed_late):
    """A vehicle at 90 px/s, five times a second; some stamps are late, and with ``exposed_late`` these frames, too."""
    rng = np.random.default_rng(0)
    found = []
    for number in range(100):
        late_s = LATE.get(number, 0.0) + rng.uniform(-0.002, 0.002)
        shown_s = 0.2 * number + (late_s if exposed_late else 0.0)
        left_px = 20.0 + 90.0 * shown_s
        box = np.array([[left_px, 100.0, left_px + 120.0, 170.0]]) + 0.3 * rng.standard_normal(4)
        found.append(Detections2D("cam", round(1e9 * (0.2 * number + late_s)), box, np.ones(1), np.zeros(1, np.int64)))
    return found


@pytest.mark.parametrize(("exposed_late", "slope"), [(True, 1.0), (False, 0.0)])
def test_vehicles_tell_frames_that_were_exposed_late_from_frames_that_arrived_late(exposed_late, slope, capsys):
    count, stamp_s, seen_s, weight = late_frames(frames(exposed_late=exposed_late))
    assert count == len(LATE) == len(weight)
    assert stamp_s == pytest.approx(list(LATE.values()), abs=0.005)
    assert seen_s.mean() == pytest.approx(slope * np.mean(list(LATE.values())), abs=0.01)
    tell_stamps(frames(exposed_late=exposed_late))
    told = capsys.readouterr().out
    assert "6 of 100 stamps" in told
    assert float(told.split("follow them by ")[1].split()[0]) == pytest.approx(slope, abs=0.1)
