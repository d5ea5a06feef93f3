"""Clocks of recordings whose segments lie elsewhere than assumed."""

import numpy as np
import pytest

from wibam_core.clocks import ClockMap, ClockPiece

S = 10**9


def test_each_segment_has_its_own_shift_and_times_between_them_meet_no_frame():
    # two segments of 8 s, joined as if the camera had gone on at once: it was off for a minute
    clock = ClockMap(offset_ns=3 * S, drift=1e-3, pieces=(ClockPiece(8 * S, 60 * S),))
    local = np.array([0, 4 * S, 8 * S - 1, 8 * S, 12 * S])
    reference = clock.to_reference_ns(local)
    assert reference.tolist() == [3 * S, 7_004_000_000, 11_007_999_999, 71_008_000_000, 75_012_000_000]
    assert clock.to_local_ns(reference).tolist() == local.tolist()
    assert clock.to_local_ns(40 * S) == 8 * S - 1  # switched off: nothing of the second segment


def test_a_single_time_and_a_clock_without_pieces():
    assert int(ClockMap(5).to_reference_ns(7)) == 12
    assert int(ClockMap(5).to_local_ns(12)) == 7


def test_segments_cannot_change_places():
    with pytest.raises(ValueError, match="ascend"):
        ClockMap(pieces=(ClockPiece(5 * S, 0), ClockPiece(8 * S, -4 * S)))
    with pytest.raises(ValueError, match="ascend"):
        ClockMap(pieces=(ClockPiece(5 * S, 0), ClockPiece(5 * S, S)))
