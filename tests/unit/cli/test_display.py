"""How stages are shown in a terminal."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from wibam_core.cli.display import StageDisplay, time_left


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (41.2, "41 s"), (89.0, "89 s"), (100.0, "2 min"), (9000.0, "2.5 h")]
)
def test_times_are_a_few_letters(seconds: float, text: str) -> None:
    assert time_left(seconds) == text


@pytest.mark.parametrize(("state", "shows"), [("running", True), ("succeeded", False)])
def test_only_a_running_stage_shows_the_time_left(state: str, shows: bool) -> None:
    stream = io.StringIO()
    with StageDisplay(Console(file=stream, force_terminal=True, width=200, color_system=None)) as display:
        display.update("lift", state, 0.5, remaining_s=180.0)
    assert ("3 min left" in stream.getvalue()) is shows
