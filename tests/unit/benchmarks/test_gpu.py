"""The script that measures GPUs runs where there is none."""

from __future__ import annotations

import re

import pytest

from benchmarks.gpu import main


def test_it_trains_and_detects_on_the_processor(capsys: pytest.CaptureFixture[str]) -> None:
    """The small network alone is trained: a step of DLA-34 takes many seconds there."""
    main(["--device", "cpu", "--steps", "1", "--instants", "1", "--images", "1", "--small", "2", "--dla34"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "no GPU: the processor"
    rows = [re.split(r"\s+", line) for line in lines if line.startswith(("small", "dla34"))]
    assert [row[0] for row in rows] == ["small", "small", "dla34"]
    assert rows[0][1] == "2"
    assert all(float(rate) > 0 for row in rows for rate in row[1:-1])
    assert all(row[-1] == "–" for row in rows)
