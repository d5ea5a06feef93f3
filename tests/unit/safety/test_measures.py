from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.safety.test_conflicts import straight
from wibam_core.config import SafetyConfig
from wibam_core.documents.conflicts import ConflictRow
from wibam_core.safety.conflicts import find_conflicts
from wibam_core.safety.delta_speed import delta_speed_mps
from wibam_core.safety.document import conflicts_document
from wibam_core.safety.encounter import Encounter
from wibam_core.safety.measures import MEASURES
from wibam_core.safety.stopping import stopping_share

BOXES = np.zeros((2, 7))
SPEED = st.floats(0.1, 40.0)


def encounter(first: tuple[float, float], second: tuple[float, float], ttc_s: float = 2.0) -> Encounter:
    return Encounter(BOXES, np.array([first, second]), ttc_s)


def test_delta_speed_is_that_of_a_follower_a_crossing_and_a_head_on_pair() -> None:
    assert delta_speed_mps(encounter((12.0, 0.0), (5.0, 0.0))) == 7.0
    assert delta_speed_mps(encounter((3.0, 0.0), (0.0, 4.0))) == 5.0
    assert delta_speed_mps(encounter((10.0, 0.0), (-8.0, 0.0))) == 18.0


def test_stopping_takes_the_way_that_the_braking_law_says() -> None:
    # 17 m/s: 42.5 m at 3.4 m/s²; 2.5 s away are 42.5 m, too
    assert stopping_share(encounter((17.0, 0.0), (0.0, 1.0), ttc_s=2.5)) == pytest.approx(1.0)
    assert stopping_share(encounter((0.0, 0.0), (0.0, 0.0))) == math.inf
    assert stopping_share(encounter((5.0, 0.0), (0.0, 0.0), ttc_s=math.inf)) == math.inf


@given(SPEED, SPEED, st.floats(0.1, 5.0))
def test_the_share_is_that_of_the_one_that_has_less(first: float, second: float, ttc_s: float) -> None:
    alone = [stopping_share(encounter((v, 0.0), (0.0, 0.0), ttc_s)) for v in (first, second)]
    assert stopping_share(encounter((first, 0.0), (0.0, second), ttc_s)) == pytest.approx(min(alone))


def test_names_of_measures_are_unlike_and_no_field_of_a_conflict() -> None:
    names = [measure.name for measure in MEASURES]
    assert len(set(names)) == len(names)
    assert not set(names) & set(ConflictRow.model_fields)


def test_a_conflict_carries_them_and_null_where_there_is_none() -> None:
    config = SafetyConfig()
    chase = find_conflicts([straight(1, (0, 0), 0.0, 15, 2), straight(2, (30, 0), 0.0, 3, 2)], config)
    passed = find_conflicts(
        [straight(4, (0, -20), np.pi / 2, 10, seconds=5), straight(2, (-31, 0), 0.0, 10, seconds=5)],
        SafetyConfig(ttc_s=0.1),
    )
    rows = conflicts_document([*chase, *passed], config).conflicts
    assert [row.measures["delta_speed_mps"] for row in rows] == pytest.approx([12.0, 10.0 * 2**0.5])
    assert rows[0].ttc_s is not None
    assert rows[0].measures["stopping_share"] == pytest.approx(2 * 3.4 * rows[0].ttc_s / 15.0)
    assert (rows[1].ttc_s, rows[1].measures["stopping_share"]) == (None, None)
