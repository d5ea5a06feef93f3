from __future__ import annotations

import numpy as np

from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.risks import Risks
from wibam_core.synthetic.routes import footprints_overlap
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.traffic import Traffic, simulate_traffic


def _traffic(risks: Risks, seed: int = 2) -> Traffic:
    return simulate_traffic(make_layout(seed), seed, 60.0, SignalProgram(30.0), risks=risks)


def _hardest_braking_mps2(traffic: Traffic) -> float:
    return max(float(-np.diff(t.speed_mps).min(initial=0.0)) / 0.04 for t in traffic.trajectories if t.route)


def test_who_looks_away_brakes_harder_and_the_same_risks_give_the_same_traffic() -> None:
    calm, risky, again = (_traffic(Risks(looking_away=share)) for share in (0.0, 1.0, 1.0))
    # at a red light drivers brake late, but no harder than they must: it is those ahead who surprise
    assert _hardest_braking_mps2(risky) > max(4.5, _hardest_braking_mps2(calm) - 1.0)
    for one, two in zip(risky.trajectories, again.trajectories, strict=True):
        assert np.array_equal(one.s_m, two.s_m)


def test_who_runs_red_passes_the_stop_line_while_the_light_is_red() -> None:
    def late(traffic: Traffic) -> int:
        count = 0
        for t in traffic.trajectories:
            if t.route is None or t.s_m[0] + t.model.length_m / 2 > t.route.stop_s_m:
                continue
            past = np.flatnonzero(t.s_m + t.model.length_m / 2 > t.route.stop_s_m + 0.5)
            if len(past):
                time_s = (t.first_step + int(past[0])) * 0.04
                count += traffic.program.state(t.route.incoming.phase, time_s) == "red"
        return count

    assert late(_traffic(Risks(running_red=1.0))) > late(_traffic(Risks()))


def test_forcing_drivers_do_not_drive_through_others() -> None:
    traffic = _traffic(Risks(looking_away=0.3, forcing=1.0, running_red=0.3))
    for time_s in np.arange(0.0, 60.0, 0.4).tolist():
        _, boxes = traffic.at(time_s)
        i, j = np.triu_indices(len(boxes), 1)
        assert not footprints_overlap(boxes[i], boxes[j]).any()
