"""The signal program is consistent with itself."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.synthetic.layout import PHASES
from wibam_core.synthetic.signals import SignalProgram

programs = st.builds(SignalProgram, cycle_s=st.floats(14, 120), offset_s=st.floats(0, 100))


@given(programs, st.floats(-100, 300))
def test_phases_never_share_green_or_amber(program: SignalProgram, time_s: float) -> None:
    assert sum(state != "red" for state in program.states(time_s).values()) <= 1


@given(programs)
def test_changes_are_where_the_state_changes(program: SignalProgram) -> None:
    changes = program.changes(0.0, 3 * program.cycle_s)
    assert len(changes) == pytest.approx(3 * 3 * len(PHASES), abs=len(PHASES))
    assert changes == sorted(changes)
    for time_s, phase, before, after in changes:
        assert program.state(phase, time_s - 1e-6) == before
        assert program.state(phase, time_s + 1e-6) == after


@given(programs)
def test_order_is_green_amber_red(program: SignalProgram) -> None:
    follow = {"green": "amber", "amber": "red", "red": "green"}
    assert all(follow[before] == after for _, _, before, after in program.changes(0, 2 * program.cycle_s))


def test_too_short_a_cycle_is_refused() -> None:
    with pytest.raises(ValueError, match="green"):
        SignalProgram(cycle_s=10.0)
