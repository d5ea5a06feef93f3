from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.video.sampling import (
    Span,
    common_instants,
    multiples_within,
    nearer_times,
    nearest_times,
    overlap_s,
    period_ns,
)

S = 10**9
spans = st.tuples(st.integers(-20 * S, 20 * S), st.integers(0, 20 * S)).map(lambda pair: Span(pair[0], sum(pair)))
rates = st.sampled_from([1.0, 2.5, 6.25, 12.5, 25.0, 30.0, 29.97])


@given(spans, rates)
def test_law_multiples_are_all_those_inside(span: Span, rate_hz: float) -> None:
    times = multiples_within(span, rate_hz)
    period = period_ns(rate_hz)
    assert all(abs(t - round(t / period) * period) <= 0.5 for t in times.tolist())
    assert (np.abs(np.diff(times) - float(period)) <= 1).all()
    inside = span.last_ns // period - -(-span.first_ns // period) + 1
    assert len(times) == inside


@given(st.lists(spans, min_size=2, max_size=4), rates)
def test_law_two_recordings_span_every_common_instant(every: list[Span], rate_hz: float) -> None:
    named = {str(i): span for i, span in enumerate(every)}
    common = set(common_instants(named, rate_hz).tolist())
    for span in every:
        for t in multiples_within(span, rate_hz).tolist():
            covers = sum(other.first_ns <= t <= other.last_ns for other in every)
            # an instant rounded to ns may lie a ns outside the span that its exact time touches
            near_edge = any(min(abs(t - other.first_ns), abs(t - other.last_ns)) <= 1 for other in every)
            assert (t in common) == (covers >= 2) or near_edge


@given(st.lists(spans, min_size=2, max_size=4))
def test_law_instants_are_as_long_as_the_overlap_allows(every: list[Span]) -> None:
    named = {str(i): span for i, span in enumerate(every)}
    if overlap_s(named) > 1.01:
        assert len(common_instants(named, 2.5)) >= 2
    if overlap_s(named) == 0.0:
        assert len(common_instants(named, 2.5)) <= 1


def test_rates_share_their_instants() -> None:
    span = Span(-3 * S + 17, 5 * S + 3)
    fast, slow = (set(multiples_within(span, rate).tolist()) for rate in (12.5, 2.5))
    assert slow < fast
    assert multiples_within(Span(0, S), 12.5)[:3].tolist() == [0, 80_000_000, 160_000_000]


def test_one_recording_keeps_all_its_instants_and_none_has_none() -> None:
    assert len(common_instants({"a": Span(0, 2 * S)}, 10.0)) == 21
    assert len(common_instants({}, 10.0)) == 0
    with pytest.raises(ValueError, match="end"):
        Span(1, 0)


def test_clocks_may_be_years_apart() -> None:
    epoch = 1_700_000_000 * S
    far = {"a": Span(0, 2 * S), "b": Span(epoch, epoch + 2 * S), "c": Span(epoch + S, epoch + 3 * S)}
    assert common_instants(far, 2.0).tolist() == [epoch + S + i * S // 2 for i in range(3)]


TIMES = st.lists(st.integers(0, 60), unique=True, max_size=12).map(sorted)


@given(times=TIMES, damaged=st.sets(st.integers(0, 60)), target=st.integers(-10, 70), tolerance=st.integers(0, 20))
def test_law_nearest_times_are_what_a_search_finds(
    times: list[int], damaged: set[int], target: int, tolerance: int
) -> None:
    """And the frames that were tried before what was found are those that had to be damaged for that."""
    sound = [time for time in times if time not in damaged]
    by_preference = sorted(times, key=lambda time: (abs(time - target), time))
    within = [time for time in by_preference if abs(time - target) <= tolerance]
    expected = next((time for time in within if time in sound), None)
    (found,) = nearest_times(np.array(sound, np.int64), np.array([target]), tolerance)
    assert found == expected
    tried = within if expected is None else within[: within.index(expected)]
    assert sorted(tried) == nearer_times(np.array(times, np.int64), target, found, tolerance)


def test_nearest_times_of_many_targets_are_those_of_each() -> None:
    times, targets = np.array([0, 40, 80, 200]), np.array([-30, 20, 21, 79, 140, 141, 260])
    assert nearest_times(times, targets, 60) == [0, 0, 40, 80, 80, 200, 200]
