"""Conflicts as CSV."""

from __future__ import annotations

import csv
import io

from tests.finished import CONFLICT
from wibam_core.adapters.results import conflicts_csv
from wibam_core.documents.conflicts import Conflicts


def header(*conflicts: object) -> list[str]:
    text = "".join(conflicts_csv(Conflicts.model_validate({"thresholds": {}, "conflicts": list(conflicts)})))
    return next(csv.reader(io.StringIO(text)))


def test_without_conflicts_the_columns_are_those_of_any_conflict_but_for_measures() -> None:
    empty, one = header(), header(CONFLICT)
    assert "ttc_interval_s_low" in empty and "track_ids_2" in empty
    assert one[: len(empty)] == empty
    assert set(one[len(empty) :]) == set(CONFLICT.measures)
