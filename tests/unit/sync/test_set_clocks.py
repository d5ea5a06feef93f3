"""Clocks that were set while a camera recorded, told from frames that are missing."""

import numpy as np
import pytest

from tests.unit.sync.test_offsets import events, observe
from wibam_core.clocks import SignalChange
from wibam_core.sync.document import sync_document
from wibam_core.sync.set_clocks import least_share, set_cautions, synchronise_set_clocks


def stamped(changes, later):
    """The same changes, stamped later by the seconds that ``later`` says of each time (s)."""
    return [
        SignalChange(
            c.camera_id,
            c.signal_id,
            round(c.time_ns + 1e9 * later(c.time_ns / 1e9)),
            c.before,
            c.after,
            0.9,
            40_000_000,
        )
        for c in changes
    ]


def sorted_out(changes, known, cut, broken="c1"):
    whole = {c: [(0.0, 900.0)] for c in changes}
    found = synchronise_set_clocks(whole | {broken: known}, whole | {broken: cut}, "c0", changes=changes)
    return found, set_cautions(found, whole | {broken: known})


def with_gap(met_share, broken):
    """Nothing from 450 to 480 s; of what follows a share comes 5 s late, and the rest anywhere."""
    rng = np.random.default_rng(5)
    what = events(rng, 900.0)
    changes = {c: observe(rng, c, what) for c in ("c0", "c1", "c2")}
    seen = [c for c in changes[broken] if not 450e9 < c.time_ns < 480e9]
    changes[broken] = sorted(
        stamped(seen, lambda t: 0.0 if t < 465 else 5.0 if rng.random() < met_share else rng.uniform(480, 895) - t),
        key=lambda c: c.time_ns,
    )
    return sorted_out(changes, [(0.0, 900.0)], [(0.0, 450.0), (480.0, 900.0)], broken)


@pytest.mark.parametrize("broken", ["c0", "c1"])
def test_what_follows_a_gap_counts_as_what_was_before(broken):
    """Half of the changes follow, of which 0.6 meet under any clock: about 0.8 of all."""
    found, [caution] = with_gap(0.6, broken)
    assert caution.details["shift_s"] == pytest.approx(-5.0, abs=0.05)
    assert least_share(found) == found.shares[broken] == pytest.approx(0.8, abs=0.12)
    document = sync_document({}, found.found.result, placed=found.placed)
    assert document.cameras["c1"].score == pytest.approx(found.shares["c1"], abs=1e-3)


def test_a_clock_that_was_set_once_is_said_once():
    rng = np.random.default_rng(6)
    what = events(rng, 900.0)
    changes = {c: observe(rng, c, what) for c in ("c0", "c1")}
    seen = [c for c in changes["c1"] if not any(begin < c.time_ns / 1e9 < begin + 15 for begin in (300, 600))]
    changes["c1"] = stamped(seen, lambda t: 0.0 if t < 300 else 20.0)
    spans = [(0.0, 300.0), (335.0, 620.0), (635.0, 920.0)]
    found, [caution] = sorted_out(changes, [(0.0, 920.0)], spans)
    assert [one.shift_s for one in found.placed["c1"]] == pytest.approx([-20.0, -20.0], abs=0.05)
    assert caution.details["at_s"] == 335.0 and caution.details["shift_s"] == pytest.approx(-20.0, abs=0.05)
