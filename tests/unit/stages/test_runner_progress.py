"""What the pipeline says of a running stage's time."""

from __future__ import annotations

import pytest

from wibam_core.stages import runner
from wibam_core.stages.runner import StageUpdate


def test_updates_tell_the_time_left_and_waiting_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(runner.time, "monotonic", lambda: now[0])
    updates: list[StageUpdate] = []
    report = runner._progress_of("lift", updates.append)
    now[0] = 500.0
    report(0.0, "waiting")
    now[0] = 510.0
    for fraction in (0.01, 0.25, 1.0):
        report(fraction)
    assert [update.remaining_s for update in updates] == [None, None, pytest.approx(30.0), 0.0]
