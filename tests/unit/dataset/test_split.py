from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.config import DatasetConfig
from wibam_core.dataset.split import MIN_INSTANTS, at_rate, split_in_time
from wibam_core.documents.split import SUBSETS, Split
from wibam_core.errors import TooFewInstants
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, MultiViewVehicle

RATE_HZ = 12.5


def vehicle(track_id: int) -> MultiViewVehicle:
    return MultiViewVehicle(0, track_id, RoadUserClass.CAR, 0.0, 0.0, {"cam1": 0, "cam2": 0})


def footage(seconds: float, spans: dict[int, tuple[float, float]] | None = None, start_ns: int = 7_000) -> list:
    """Instants at 12.5 Hz; track id -> first and last second in view."""
    instants = []
    for k in range(round(seconds * RATE_HZ)):
        t = k / RATE_HZ
        there = tuple(vehicle(i) for i, (a, b) in (spans or {}).items() if a <= t <= b)
        instants.append(AnnotatedInstant(start_ns + round(t * 1e9), {}, there))
    return instants


def test_shares_and_gaps_of_a_minute() -> None:
    split = split_in_time(footage(60), DatasetConfig())
    counts = {name: len(split.times_ns[name]) for name in SUBSETS}
    assert counts == pytest.approx({"train": 105, "val": 21, "test": 14}, abs=1)
    for earlier, later in (("train", "val"), ("val", "test")):
        assert split.times_ns[later][0] - split.times_ns[earlier][-1] >= 2e9


def test_a_waiting_vehicle_is_left_out_of_the_earlier_subset() -> None:
    spans = {0: (5.0, 20.0), 1: (40.0, 48.0), 2: (50.0, 58.0), 3: (30.0, 59.0), -1: (0.0, 60.0)}
    split = split_in_time(footage(60, spans), DatasetConfig())
    assert split.left_out_tracks == {"train": {1, 3}, "val": {2, 3}, "test": frozenset()}
    last = footage(60, spans)[-40]
    assert {v.track_id for v in split.may_teach("test", last)} == {2, 3, -1}


def test_without_validation_there_is_one_gap() -> None:
    split = split_in_time(footage(30), DatasetConfig(val_share=0.0, train_share=0.8))
    assert split.times_ns["val"] == ()
    assert len(split.times_ns["train"]) == pytest.approx(0.8 * 28 * 2.5, abs=1)
    assert len(split.times_ns["test"]) == pytest.approx(0.2 * 28 * 2.5, abs=1)


@pytest.mark.parametrize("seconds", [0.0, 1.0, 5.0, 12.0])
def test_too_short_footage_says_how_much_more(seconds: float) -> None:
    with pytest.raises(TooFewInstants, match="of footage") as raised:
        split_in_time(footage(seconds), DatasetConfig())
    more_s = raised.value.details["more_s"]
    assert f"{more_s} s longer" in raised.value.hint
    split_in_time(footage(seconds + more_s), DatasetConfig())


def test_a_low_rate_does_not_lengthen_the_footage() -> None:
    """24 s at one instant in 10 s: three instants, and not 30 s."""
    with pytest.raises(TooFewInstants, match=r"^24\.0 s of footage gives 2 train instants") as raised:
        split_in_time(footage(24), DatasetConfig(rate_hz=0.1, gap_s=0.0))
    assert "gap_s" not in raised.value.hint
    split_in_time(footage(24 + raised.value.details["more_s"]), DatasetConfig(rate_hz=0.1, gap_s=0.0))


def test_large_gaps_are_named_as_a_reason() -> None:
    with pytest.raises(TooFewInstants) as raised:
        split_in_time(footage(60), DatasetConfig(gap_s=25.0))
    assert "lower dataset.gap_s (gaps take 50 s)" in raised.value.hint


def test_shares_that_leave_no_test() -> None:
    with pytest.raises(TooFewInstants, match="nothing for test"):
        split_in_time(footage(60), DatasetConfig(train_share=0.8, val_share=0.2))


@given(
    seconds=st.floats(40, 90),
    gap_s=st.floats(0, 4),
    val_share=st.sampled_from([0.0, 0.1, 0.15]),
    spans=st.lists(st.tuples(st.floats(0, 80), st.floats(0, 60)), max_size=6),
)
def test_laws(seconds: float, gap_s: float, val_share: float, spans: list[tuple[float, float]]) -> None:
    instants = footage(seconds, {k: (a, a + b) for k, (a, b) in enumerate(spans)})
    config = DatasetConfig(gap_s=gap_s, val_share=val_share)
    split = split_in_time(instants, config)
    tracks: dict[str, set[int]] = {}
    subset_of = split.subset_of()
    for name in SUBSETS:
        assert list(split.times_ns[name]) == sorted(split.times_ns[name])
        labels = [v for i in instants if subset_of.get(i.time_ns) == name for v in split.may_teach(name, i)]
        tracks[name] = {v.track_id for v in labels}
    assert not tracks["train"] & tracks["val"]
    assert not (tracks["train"] | tracks["val"]) & tracks["test"]
    seen_in_test = {v.track_id for i in instants if subset_of.get(i.time_ns) == "test" for v in i.vehicles}
    assert tracks["test"] == seen_in_test, "the test subset loses no vehicle"
    ordered = [split.times_ns[name] for name in SUBSETS if split.times_ns[name]]
    for earlier, later in pairwise(ordered):
        assert later[0] - earlier[-1] >= gap_s * 1e9 - 1
    assert min(len(times) for times in ordered) >= MIN_INSTANTS


def test_it_survives_json() -> None:
    split = split_in_time(footage(60, {1: (40.0, 50.0)}), DatasetConfig())
    assert Split.model_validate_json(split.model_dump_json()) == split


def test_the_rate_is_kept_on_uneven_timestamps() -> None:
    rng = np.random.default_rng(0)
    times = np.rint(np.arange(0, 20, 1 / 29.97) * 1e9 + rng.uniform(-1e5, 1e5, 600)[:600]).astype(np.int64)
    chosen = at_rate(np.sort(times), 2.5)
    assert len(chosen) == 50
    assert np.abs(np.diff(chosen) - 4e8).max() < 4e7


def test_a_rate_above_the_footage_s_own_keeps_everything() -> None:
    times = np.arange(100) * 80_000_000
    assert at_rate(times, 50.0).tolist() == times.tolist()


def test_an_instant_cannot_be_in_two_subsets() -> None:
    none: dict[str, frozenset[int]] = {name: frozenset() for name in SUBSETS}
    with pytest.raises(ValueError, match="two subsets"):
        Split(times_ns={"train": (1, 2), "val": (2,), "test": (3,)}, left_out_tracks=none)
