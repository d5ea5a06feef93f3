"""Stamps of one file, as arrays: which frames are kept, and when they were taken, against when they truly were."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from wibam_core.video.stamps import run_backwards, sort_stamps

S = 1_000_000_000
TRUE_NS = np.rint(np.arange(480) * S / 24).astype(np.int64)
Stamps = NDArray[np.int64]


def decoding_order() -> Stamps:
    """Frame numbers as packets hold them where two of three frames are predicted from both sides."""
    return np.concatenate([[0], *([n + 3, n + 1, n + 2] for n in range(0, 477, 3)), [478, 479]]).astype(np.int64)


ORDERS = pytest.mark.parametrize("order", [np.arange(480), decoding_order()], ids=["as shown", "reordered"])


def between(first: int, last: int, shift_s: float) -> Callable[[Stamps], Stamps]:
    return lambda stamps: stamps + np.where((np.arange(480) >= first) & (np.arange(480) < last), round(shift_s * S), 0)


def wild(count: int) -> Callable[[Stamps], Stamps]:
    rng = np.random.default_rng(0)
    frames = rng.choice(480, count, replace=False)
    return lambda stamps: stamps + np.bincount(frames, rng.integers(20, 100, count) * S, 480).astype(np.int64)


@ORDERS
@pytest.mark.parametrize(
    ("changed", "kept", "segments"),
    [
        (between(479, 480, 30.0), 479, 1),
        (between(1, 480, 30.0), 479, 1),
        (between(60, 63, 600.0), 477, 1),
        (wild(60), 420, 1),
        (between(240, 480, -10.0), 480, 2),
        (between(240, 480, 7200.0), 480, 2),
        (between(240, 360, -300.0), 480, 3),
        (between(240, 360, 300.0), 480, 3),
        (between(240, 360, 7200.0), 480, 3),
    ],
    ids=["last", "first", "few", "many", "restart", "later day", "back and forth", "forth and back", "hours"],
)
def test_stamps_that_are_wrong_for_a_while_move_no_other_frame(order, changed, kept, segments):  # type: ignore[no-untyped-def]
    found = sort_stamps(changed(TRUE_NS[order]))
    assert (int(found.kept.sum()), len(found.segments)) == (kept, segments)
    errors_ns = (found.times_ns - TRUE_NS[order])[found.kept]
    # where a clock starts anew, frames that were reordered over that moment may be put a few frames late
    assert np.abs(errors_ns - np.median(errors_ns)).max() <= (4 if segments > 1 else 0) * S / 24
    assert (np.diff(np.sort(found.times_ns[found.kept])) > 0).all()


def test_a_clock_that_was_set_back_says_that_no_time_was_lost() -> None:
    found = sort_stamps(between(240, 360, -300.0)(TRUE_NS))
    assert [stretch.jump_before for stretch in found.segments] == [False, True, False]


#: Frames shown next, in decoding order: some predicted from both sides, these from others, two groups in a row, many.
RARELY = [[1, 0], [2, 0, 1], [3, 1, 0, 2], [7, 3, 1, 0, 2, 5, 4, 6], [2, 0, 1, 5, 3, 4], [15, *range(15)]]


@pytest.mark.parametrize("group", RARELY, ids=str)
@pytest.mark.parametrize("at", [0, 200, 464])
def test_few_reordered_frames_are_no_clock_that_was_set(group: list[int], at: int) -> None:
    stamps = TRUE_NS.copy()
    stamps[at : at + len(group)] = TRUE_NS[at + np.array(group)]
    found = sort_stamps(stamps)
    np.testing.assert_array_equal(found.times_ns, stamps)
    assert found.kept.all() and len(found.segments) == 1 and found.stray == 0
    np.testing.assert_array_equal(found.segments[0].indices, np.arange(480))


@pytest.mark.parametrize("back", [2.6, 3.0, 5.3, 8.0, 15.0])
@pytest.mark.parametrize("jitter", [0.0, 0.03])
def test_a_clock_set_back_by_less_than_reordering_takes_is_still_found(back: float, jitter: float) -> None:
    """Frames that come after are put behind those before; elsewhere a few are reordered."""
    rng = np.random.default_rng(0)
    true = TRUE_NS + np.rint(rng.uniform(-jitter, jitter, 480) * S / 24).astype(np.int64)
    order = np.arange(480)
    order[100:104] = 100 + np.array([3, 1, 0, 2])
    found = sort_stamps(between(240, 480, -back / 24)(true)[order])
    assert found.kept.all()
    assert [(len(stretch.indices), stretch.jump_before) for stretch in found.segments] == [(240, False), (240, True)]
    assert np.abs(found.times_ns - true[order]).max() <= (2 * jitter + 0.01) * S / 24


def test_a_stray_stamp_just_ahead_moves_no_other_frame() -> None:
    """What it passes over does not fill the time up to it: its own place is empty."""
    for ahead in (4.0, 5.3, 5.7, 9.5):
        found = sort_stamps(between(200, 201, ahead / 24)(TRUE_NS))
        assert np.flatnonzero(~found.kept).tolist() == [200]
        np.testing.assert_array_equal(found.times_ns[found.kept], TRUE_NS[found.kept])


def test_times_without_frames_stay() -> None:
    stamps = between(240, 480, 12.0)(between(360, 480, 15.0)(TRUE_NS))
    found = sort_stamps(stamps)
    np.testing.assert_array_equal(found.times_ns, stamps)
    assert [stretch.jump_before for stretch in found.segments] == [False, False, False]


@ORDERS
def test_a_clock_that_runs_backwards_is_none_that_is_reordered(order) -> None:  # type: ignore[no-untyped-def]
    assert not run_backwards(TRUE_NS[order])
    assert run_backwards(TRUE_NS[order][::-1])
