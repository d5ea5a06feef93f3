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


def test_times_without_frames_stay() -> None:
    stamps = between(240, 480, 12.0)(between(360, 480, 15.0)(TRUE_NS))
    found = sort_stamps(stamps)
    np.testing.assert_array_equal(found.times_ns, stamps)
    assert [stretch.jump_before for stretch in found.segments] == [False, False, False]


@ORDERS
def test_a_clock_that_runs_backwards_is_none_that_is_reordered(order) -> None:  # type: ignore[no-untyped-def]
    assert not run_backwards(TRUE_NS[order])
    assert run_backwards(TRUE_NS[order][::-1])
