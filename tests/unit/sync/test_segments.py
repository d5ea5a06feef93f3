"""Recordings that were interrupted for an unknown time: each segment is placed by what it shows."""

import numpy as np
import pytest

from tests.unit.sync.test_offsets import events, observe
from tests.unit.sync.test_traffic import drives, seen
from wibam_core.clocks import SignalChange
from wibam_core.errors import NoSignalChange
from wibam_core.sync.document import doubts, sync_document
from wibam_core.sync.paths import GroundPath
from wibam_core.sync.segments import synchronise_segments


def interrupted(changes, at_s, off_s):
    """What a camera would have seen that was off for ``off_s`` from ``at_s`` on, and put what follows right behind."""
    kept = []
    for c in changes:
        if c.time_ns < at_s * 1e9:
            kept.append(c)
        elif c.time_ns > (at_s + off_s) * 1e9:
            time_ns = c.time_ns - round(off_s * 1e9)
            kept.append(SignalChange(c.camera_id, c.signal_id, time_ns, c.before, c.after, 0.9, c.half_interval_ns))
    return kept


def mapped_s(clock, local_s):
    return int(clock.to_reference_ns(round(local_s * 1e9))) / 1e9


@pytest.mark.parametrize("broken", ["c0", "c1"])
def test_a_camera_that_was_off_is_found_again_by_the_lights(broken):
    """Off for 61.3 s after 300 s; the reference camera, or another one."""
    rng = np.random.default_rng(0)
    what = events(rng, 900.0)
    changes = {c: observe(rng, c, what, offset_s, 2e-5) for c, offset_s in (("c0", 0.0), ("c1", 3.0), ("c2", -7.0))}
    changes[broken] = interrupted(changes[broken], 300.0, 61.3)
    spans = {c: [(0.0, 900.0)] for c in changes} | {broken: [(0.0, 300.0), (300.05, 838.0)]}
    found = synchronise_segments(spans, "c0", changes=changes)
    [piece] = found.placed[broken]
    assert piece.from_s == 300.05
    assert piece.shift_s == pytest.approx(61.3, abs=max(4 * piece.sd_s, 0.02)) and piece.sd_s < 0.02
    assert piece.matched > 10
    assert not any(found.assumed.values())
    clocks = found.found.result.clocks
    assert set(clocks) == set(changes)
    other = "c1" if broken == "c0" else "c0"
    late = mapped_s(clocks[broken], 600.0 - 61.3)
    offset_s = {"c0": 0.0, "c1": 3.0}
    assert late - mapped_s(clocks[other], 600.0 + offset_s[broken] - offset_s[other]) == pytest.approx(0.0, abs=0.06)
    assert late - mapped_s(clocks[broken], 200.0) == pytest.approx(400.0, abs=0.08)
    document = sync_document(changes, found.found.result, placed=found.placed, assumed=found.assumed)
    assert [one.shift_s for one in document.cameras[broken].segments] == [piece.shift_s]
    assert {g for o in document.groups for g in (s.camera for s in o.observations)} == set(changes)


def test_a_segment_is_found_by_the_traffic_alone():
    rng = np.random.default_rng(1)
    vehicles = drives(rng, 110)
    paths = {"a": seen(rng, vehicles, 0.0), "b": seen(rng, vehicles, 10.0)}
    cut = []
    for path in paths["b"]:
        for keep, shift_s in ((path.times_s < 80.0, 0.0), (path.times_s > 93.5, 13.5)):
            if keep.sum() > 2:
                cut.append(GroundPath(path.times_s[keep] - shift_s, *(x[keep] for x in list(vars(path).values())[1:])))
    found = synchronise_segments(
        {"a": [(0.0, 180.0)], "b": [(0.0, 80.0), (80.0, 166.5)]}, "a", paths={"a": paths["a"], "b": cut}
    )
    [piece] = found.placed["b"]
    assert piece.shift_s == pytest.approx(13.5, abs=0.1)
    assert mapped_s(found.found.result.clocks["b"], 120.0) == pytest.approx(143.5, abs=0.1)
    assert {(one.first_id, one.second_id) for one in found.found.traffic} == {("a", "b")}


def test_a_segment_that_shows_nothing_stays_where_it_was_put_and_is_warned_of():
    rng = np.random.default_rng(2)
    what = events(rng, 300.0)
    changes = {"c0": observe(rng, "c0", what), "c1": observe(rng, "c1", what, 2.0)}
    changes["c1"] = [c for c in changes["c1"] if c.time_ns < 250e9]
    spans = {"c0": [(0.0, 300.0)], "c1": [(0.0, 250.0), (250.0, 254.0)]}
    found = synchronise_segments(spans, "c0", changes=changes)
    assert found.placed["c1"] == () and found.assumed["c1"] == (250.0,)
    assert found.found.result.clocks["c1"].pieces == ()
    document = sync_document(changes, found.found.result, placed=found.placed, assumed=found.assumed)
    [warning] = [doubt for doubt in doubts(document, None) if doubt.code == "segment_unplaced"]
    assert "c1 goes on after 250.0 s is assumed" in warning.message
    assert warning.details == {"camera": "c1", "at_s": [250.0]}


def test_a_change_across_a_joint_is_not_believed():
    """What looks like a change is the time that the camera was off."""
    rng = np.random.default_rng(3)
    what = events(rng, 900.0)
    changes = {"c0": observe(rng, "c0", what), "c1": interrupted(observe(rng, "c1", what), 300.0, 100.0)}
    changes["c1"].append(SignalChange("c1", "s0", 300_025_000_000, "red", "green", 0.9, 40_000_000))
    changes["c1"].sort(key=lambda c: c.time_ns)
    spans = {"c0": [(0.0, 900.0)], "c1": [(0.0, 300.0), (300.05, 799.0)]}
    found = synchronise_segments(spans, "c0", changes=changes)
    used = [g.seen["c1"].time_ns for g in found.found.result.groups if "c1" in g.seen]
    assert 300_025_000_000 not in used
    assert found.placed["c1"][0].shift_s == pytest.approx(100.0, abs=0.03)


def test_cameras_that_share_nothing_are_still_refused():
    rng = np.random.default_rng(4)
    changes = {"c0": observe(rng, "c0", events(rng, 300.0)), "c1": []}
    with pytest.raises(NoSignalChange, match="c1"):
        synchronise_segments({"c0": [(0.0, 300.0)], "c1": [(0.0, 100.0), (101.0, 300.0)]}, "c0", changes=changes)
