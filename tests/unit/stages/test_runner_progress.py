"""What the pipeline says of a running stage's time."""

from __future__ import annotations

import pytest

from wibam_core.costs import Pace
from wibam_core.stages import runner
from wibam_core.stages.runner import StageUpdate


def test_updates_tell_the_time_left_and_waiting_does_not_count() -> None:
    now = [100.0]
    updates: list[StageUpdate] = []
    report = runner._progress_of("lift", Pace({}, {}), (), updates.append, lambda: now[0])
    now[0] = 500.0
    report(0.0, "waiting")
    now[0] = 510.0
    for fraction in (0.01, 0.25, 1.0):
        report(fraction)
    assert [update.remaining_s for update in updates] == [None, None, pytest.approx(30.0), 0.0]


def test_updates_tell_the_time_that_all_stages_will_still_take() -> None:
    now = [100.0]
    updates: list[StageUpdate] = []
    pace = Pace({"lift": 40.0, "finetune": 200.0, "report": 5.0}, {})
    report = runner._progress_of("lift", pace, ("finetune", "report"), updates.append, lambda: now[0])
    report(0.0)
    now[0] = 110.0
    report(0.25)
    assert [update.job_remaining_s for update in updates] == [pytest.approx(245.0), pytest.approx(235.0)]
    report = runner._progress_of("lift", pace, ("finetune", "safety"), updates.append, lambda: now[0])
    report(0.0)
    assert updates[-1].job_remaining_s is None  # nothing is known of one of them
