"""What the benchmark of the footage's amount makes of its rows; nothing is recorded or trained here."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks import data_amount
from tests.unit.benchmarks.learning_figures import arguments, figures
from wibam_core.documents.split import SUBSETS, Split
from wibam_core.scene import Vehicles3D


def amounts() -> list[dict[str, Any]]:
    of = {0.0: 0.4, 0.25: 0.5, 0.5: 0.58, 1.0: 0.6}
    return [
        {
            "run": {"site": site, "seed": 0, "share": share},
            "minutes": 4 * share,
            "vehicles": round(100 * share),
            **figures(bev),
        }
        for site in (1, 2)
        for share, bev in of.items()
    ]


def test_a_share_of_the_footage_is_its_first_and_all_of_it_takes_a_jobs_network(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    times = tuple(range(0, 100, 10))
    split = Split(
        times_ns={"train": times, "val": (), "test": ()}, left_out_tracks={part: frozenset({7}) for part in SUBSETS}
    )
    fits = [Vehicles3D.of(t, np.ones((2, 7)), np.zeros(2, int), np.array([t, 7]), np.ones(2)) for t in times]
    site: Any = SimpleNamespace(number=11, minutes=2.0, lifts=fits, split=split, usual_decode="refined")
    frames = {"train": [SimpleNamespace(time_ns=t) for t in times], "val": ["val"]}
    monkeypatch.setattr(data_amount, "views", lambda _, part, lifts: frames[part])
    monkeypatch.setattr(data_amount, "untrained", lambda _, decode: decode)
    monkeypatch.setattr(data_amount, "finetuned_by_stage", lambda _, asked: ("job", asked))
    monkeypatch.setattr(
        data_amount, "finetuned_on", lambda _, train, validation, config: ([v.time_ns for v in train], validation)
    )
    monkeypatch.setattr(data_amount, "figures", lambda _, trained: {"trained": trained})
    options = {"steps": 5}
    none, half, full = (data_amount.row(site, {"share": share, "finetune": options}) for share in (0, 0.5, 1))
    assert none == {"chosen_on": True, "minutes": 0, "vehicles": 0, "trained": "refined"}
    assert half == {"chosen_on": True, "minutes": 1.0, "vehicles": 5, "trained": ([0, 10, 20, 30, 40], ["val"])}
    assert full == {"chosen_on": True, "minutes": 2.0, "vehicles": 10, "trained": ("job", options)}


def test_shares_of_the_full_gain_are_told_between_the_amounts_tried() -> None:
    assert data_amount.gains(amounts()) == {0.25: pytest.approx([0.5, 0.5]), 0.5: pytest.approx([0.9, 0.9]), 1: [1, 1]}
    assert data_amount.gain_after(amounts(), 1.0) == pytest.approx(0.5)
    assert data_amount.gain_after(amounts(), 1.5) == pytest.approx(0.7)
    assert data_amount.gain_after(amounts(), 9.0) is None
    text = data_amount.advice(amounts())
    assert "One minute of footage to learn from gave 50 % of the full gain." in text
    assert "4.0 min with 100 vehicles" in text


def test_how_much_is_enough_is_told_of_amounts_that_were_tried_alone() -> None:
    assert data_amount.minutes_for(amounts(), 0.89) == 2.0
    assert data_amount.minutes_for(amounts(), 0.91) == 4.0
    assert data_amount.minutes_for(amounts(), 1.1) is None
    assert "The least amount tried that gave nine tenths of it was" in data_amount.advice(amounts())


def test_the_data_amount_document_and_curve(tmp_path: Path) -> None:
    text = data_amount.document(amounts(), "command")
    assert "| 25 % | 1.00 ± 0.00 | 25 ± 0 | 2 |" in text
    assert "(`benchmarks/looks.json`)" in text and "fits to the whole recording" in text
    data_amount.save(data_amount.curve_figure(amounts()), tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 5000
    assert [run["share"] for run in data_amount.runs_of(arguments(sites=[11], seeds=[0]))] == [0.0, 0.5, 1.0]
