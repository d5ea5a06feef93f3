import json

import numpy as np
import pytest

from wibam_core.clocks import SignalChange
from wibam_core.errors import NoSignalChange
from wibam_core.sync.document import ambiguities, doubts, sync_document
from wibam_core.sync.matching import ChangeGroup, align, match_changes
from wibam_core.sync.offsets import estimate_clocks
from wibam_core.synthetic.signals import SignalProgram

CYCLE = (("green", 17.3), ("amber", 3.0), ("red", 21.9))


def events(rng, duration_s, signals=1, jitter=0.15):
    """[(time_s, signal, before, after)] of traffic lights whose phases vary as actuated ones do."""
    found = []
    for s in range(signals):
        t, i = -rng.uniform(0, 40), 0
        while t < duration_s:
            before, length = CYCLE[i % 3]
            t += length * rng.uniform(1 - jitter, 1 + jitter) if before != "amber" else length
            i += 1
            if 0 < t < duration_s:
                found.append((t, f"s{s}", before, CYCLE[i % 3][0]))
    return sorted(found)


def observe(rng, camera_id, what, offset_s=0.0, drift=0.0, fps=12.5, missed=0.0):
    """What a camera with ``t_ref = t + offset + drift t`` sees of events: the frame interval that holds each."""
    phase = rng.uniform(0, 1 / fps)
    found = []
    for t, signal, before, after in what:
        if rng.random() < missed:
            continue
        local = (t - offset_s) / (1 + drift)
        middle = phase + (np.floor((local - phase) * fps) + 0.5) / fps
        found.append(SignalChange(camera_id, signal, round(middle * 1e9), before, after, 0.9, round(0.5e9 / fps)))
    return found


def record(rng, cameras=4, duration_s=300.0, max_offset_s=5.0, signals=1, **kwargs):
    what = events(rng, duration_s, signals)
    offsets = np.concatenate([[0.0], rng.uniform(-max_offset_s, max_offset_s, cameras - 1)])
    drifts = np.concatenate([[0.0], rng.normal(0, 3e-5, cameras - 1)])
    changes = {f"c{k}": observe(rng, f"c{k}", what, offsets[k], drifts[k], **kwargs) for k in range(cameras)}
    return changes, offsets, drifts


def errors_s(result, offsets, drifts, at_s):
    """Error of every mapped clock at a true time."""
    return [
        int(result.clocks[f"c{k}"].to_reference_ns(round((at_s - offsets[k]) / (1 + drifts[k]) * 1e9))) / 1e9 - at_s
        for k in range(1, len(offsets))
    ]


@pytest.mark.parametrize(("duration_s", "limit_ms"), [(120.0, 15.0), (300.0, 10.0)])
def test_offsets_are_found_to_a_fraction_of_a_frame(duration_s, limit_ms):
    """80 ms between frames; 8 to 20 changes."""
    rng = np.random.default_rng(0)
    found, standard = [], []
    for _ in range(20):
        changes, offsets, drifts = record(rng, duration_s=duration_s)
        result = estimate_clocks(changes, "c0")
        mean_s = np.mean([g.time_s for g in result.groups])
        found += errors_s(result, offsets, drifts, mean_s)
        standard += [result.errors[f"c{k}"].offset_sd_ns / 1e9 for k in range(1, 4)]
    rms_ms = 1e3 * np.sqrt(np.mean(np.square(found)))
    assert rms_ms < limit_ms
    assert 0.5 < rms_ms / (1e3 * np.mean(standard)) < 1.4


def test_drift_is_found_in_fifteen_minutes_and_unknown_in_one():
    rng = np.random.default_rng(1)
    what = events(rng, 900.0)
    changes = {"c0": observe(rng, "c0", what), "c1": observe(rng, "c1", what, 1.5, 4e-5)}
    result = estimate_clocks(changes, "c0")
    sd = result.errors["c1"].drift_sd
    assert sd < 1.8e-5
    assert result.clocks["c1"].drift == pytest.approx(4e-5, abs=2 * sd)
    assert result.clocks["c1"].drift > 1e-5
    assert max(abs(np.array(errors_s(result, [0, 1.5], [0, 4e-5], 890.0)))) < 0.02
    short = {camera_id: [c for c in seen if c.time_ns < 58e9] for camera_id, seen in changes.items()}
    alone = estimate_clocks(short, "c0")
    assert abs(alone.clocks["c1"].drift) < 4e-5
    assert alone.errors["c1"].drift_sd > 2e-5


def test_convention_offset_is_added_to_the_local_time():
    change = SignalChange("a", "s", 5_000_000_000, "red", "green", 1.0, 1_000_000)
    later = SignalChange("b", "s", 7_000_000_000, "red", "green", 1.0, 1_000_000)
    result = estimate_clocks({"a": [change], "b": [later]}, "a")
    assert result.clocks["b"].offset_ns == pytest.approx(-2_000_000_000, abs=2_000)
    observation = next(o for o in result.observations if o.camera_id == "b")
    assert observation.delay_before_s == pytest.approx(2.0)
    assert observation.delay_after_s == pytest.approx(0.0, abs=1e-5)


def test_large_offsets_missed_changes_and_several_signals():
    rng = np.random.default_rng(2)
    for _ in range(5):
        changes, offsets, drifts = record(rng, max_offset_s=28.0, signals=2, missed=0.2)
        result = estimate_clocks(changes, "c0")
        assert np.abs(errors_s(result, offsets, drifts, 150.0)).max() < 0.03


def test_timestamps_may_start_anywhere():
    rng = np.random.default_rng(3)
    what = [(t + 5000.0, *rest) for t, *rest in events(rng, 300.0)]
    changes = {"c0": observe(rng, "c0", what), "c1": observe(rng, "c1", what, -3.0, 4e-5)}
    result = estimate_clocks(changes, "c0")
    assert np.abs(errors_s(result, [0, -3.0], [0, 4e-5], 5150.0)).max() < 0.03


def test_a_false_change_does_not_pull_the_clock():
    rng = np.random.default_rng(4)
    changes, offsets, drifts = record(rng, cameras=3)
    wrong = changes["c1"][4]
    changes["c1"][4] = SignalChange("c1", "s0", wrong.time_ns + 90_000_000, wrong.before, wrong.after, 0.9, 40_000_000)
    changes["c2"].append(SignalChange("c2", "s0", 33_000_000_000, "amber", "red", 0.9, 40_000_000))
    changes["c2"].sort(key=lambda c: c.time_ns)
    result = estimate_clocks(changes, "c0")
    assert np.abs(errors_s(result, offsets, drifts, 150.0)).max() < 0.03


def test_a_camera_joins_through_another_that_shares_its_signal():
    rng = np.random.default_rng(5)
    what = events(rng, 300.0, signals=2)
    first, second = ([e for e in what if e[1] == s] for s in ("s0", "s1"))
    changes = {
        "c0": observe(rng, "c0", first),
        "c1": observe(rng, "c1", second, 2.0),
        "c2": observe(rng, "c2", what, -1.0),
    }
    result = estimate_clocks(changes, "c0")
    assert list(result.alignments) == ["c1", "c2"]
    assert np.abs(errors_s(result, [0, 2.0, -1.0], [0, 0, 0], 150.0)).max() < 0.03
    assert result.rms_s("c1") == (None, None)
    before, after = result.rms_s("c2")
    assert before == pytest.approx(1.0, abs=0.05)
    assert after < 0.06


def of_times(camera_id, times_s, after="green"):
    return [SignalChange(camera_id, "s", round(t * 1e9), "red", after, 1.0, 10_000_000) for t in times_s]


def test_a_fixed_cycle_is_ambiguous_by_whole_cycles_and_an_uneven_one_is_not():
    fixed = of_times("a", np.arange(10.0, 300.0, 20.0))
    groups = [ChangeGroup("s", c.before, c.after, c.time_ns / 1e9, {"a": c}) for c in fixed]
    span = {"a": (0.0, 300.0)}
    found = align(groups, of_times("b", np.arange(13.0, 300.0, 20.0)), span, (0.0, 300.0))
    assert found.taken.offset_s == pytest.approx(-3.0, abs=0.01)
    assert found.is_ambiguous
    others = [other.offset_s % 20.0 for other in found.alternatives if not other.excluded]
    assert len(others) >= 4 and others == pytest.approx([17.0] * len(others), abs=0.01)
    near = align(groups, of_times("b", np.arange(13.0, 300.0, 20.0)), span, (0.0, 300.0), near_s=38.0)
    assert near.taken.offset_s == pytest.approx(37.0, abs=0.01)
    uneven = np.cumsum(np.random.default_rng(0).uniform(10.0, 30.0, 15))
    groups = [ChangeGroup("s", c.before, c.after, c.time_ns / 1e9, {"a": c}) for c in of_times("a", uneven)]
    found = align(groups, of_times("b", uneven[4:] - uneven[3]), span, (0.0, 300.0))
    assert found.taken.offset_s == pytest.approx(uneven[3], abs=0.01)
    assert not found.is_ambiguous
    assert found.taken.share == 1.0
    assert align(groups, of_times("b", [10.0], "red_amber"), span, (0.0, 300.0)) is None


@pytest.mark.parametrize("minutes", [1.0, 5.0, 50.0])
def test_recordings_started_minutes_apart_are_found_wherever_they_overlap(minutes):
    """Ten minutes and an hour; actuated lights, so that there is one answer, but for the last, of few changes."""
    rng = np.random.default_rng(11)
    what = events(rng, 7200.0, jitter=0.2)
    length_s = 600.0 if minutes < 10.0 else 3600.0
    seen = {}
    for camera_id, start_s in (("c0", 0.0), ("c1", minutes * 60.0)):
        visible = [e for e in what if start_s < e[0] < start_s + length_s]
        seen[camera_id] = observe(rng, camera_id, visible, start_s, fps=25.0)
    result = estimate_clocks(seen, "c0", 30.0, dict.fromkeys(seen, (0.0, length_s)))
    assert not result.alignments["c1"].is_ambiguous
    assert np.abs(errors_s(result, [0, minutes * 60.0], [0, 0], minutes * 60.0 + 200.0)).max() < 0.03
    [doubt] = doubts(sync_document(seen, result), 30.0)
    assert doubt.code == "unexpected_offset"


@pytest.mark.parametrize("cycle_s", [60.0, 90.0])
@pytest.mark.parametrize("start_s", [20.0, 75.0, 130.0, 300.0])
def test_a_fixed_cycle_never_gives_a_confident_wrong_answer(cycle_s, start_s):
    rng = np.random.default_rng(12)
    steps = (("red", "green", 0.0), ("green", "amber", 0.4 * cycle_s), ("amber", "red", 0.4 * cycle_s + 3.0))
    what = sorted((k * cycle_s + after_s, "s", before, to) for k in range(20) for before, to, after_s in steps)
    seen = {
        camera_id: observe(rng, camera_id, [e for e in what if at_s < e[0] < at_s + 600.0], at_s, fps=25.0, missed=0.1)
        for camera_id, at_s in (("c0", 0.0), ("c1", start_s))
    }
    result = estimate_clocks(seen, "c0", 30.0, dict.fromkeys(seen, (0.0, 600.0)))
    alignment = result.alignments["c1"]
    assert alignment.is_ambiguous
    open_s = [alignment.taken.offset_s, *(o.offset_s for o in alignment.alternatives if not o.excluded)]
    assert min(abs(offset_s - start_s) for offset_s in open_s) < 0.05


@pytest.mark.parametrize("drift", [1e-3, -1e-3, 4.9e-3])
def test_wrong_frame_rates_are_recovered(drift):
    """29.97 frames per second that claim 30, and half a per cent."""
    rng = np.random.default_rng(13)
    what = events(rng, 600.0)
    seen = {"c0": observe(rng, "c0", what), "c1": observe(rng, "c1", what, 40.0, drift)}
    result = estimate_clocks(seen, "c0")
    assert result.alignments["c1"].taken.share > 0.9
    assert not result.alignments["c1"].is_ambiguous
    for at_s in (50.0, 550.0):
        assert np.abs(errors_s(result, [0, 40.0], [0, drift], at_s)).max() < 0.05


def test_a_rate_wrong_by_four_per_cent_is_refused():
    """25 frames per second that claim 24."""
    rng = np.random.default_rng(14)
    what = events(rng, 600.0)
    seen = {"c0": observe(rng, "c0", what), "c1": observe(rng, "c1", what, 40.0, 0.04)}
    with pytest.raises(NoSignalChange, match="meet at best") as error:
        doubts(sync_document(seen, estimate_clocks(seen, "c0")), None)
    assert "frame rates" in error.value.hint


def test_no_change_names_the_camera():
    changes, _, _ = record(np.random.default_rng(6), cameras=3)
    with pytest.raises(NoSignalChange, match="camera c2") as error:
        estimate_clocks({**changes, "c2": []}, "c0")
    assert error.value.details == {"camera": "c2"}
    stranger = [SignalChange("c2", "other", c.time_ns, c.before, c.after) for c in changes["c2"]]
    with pytest.raises(NoSignalChange, match="camera c2 shares no signal change") as error:
        estimate_clocks({**changes, "c2": stranger}, "c0")
    assert "signal id" in error.value.hint


def test_one_camera_alone_keeps_its_clock():
    changes, _, _ = record(np.random.default_rng(7), cameras=1)
    result = estimate_clocks(changes, "c0")
    assert result.clocks["c0"].offset_ns == 0
    assert result.groups == ()


def test_every_change_is_in_one_group_at_most():
    changes, _, _ = record(np.random.default_rng(8), signals=2, missed=0.3)
    groups, _ = match_changes(changes, "c0")
    used = [(camera_id, c.time_ns, c.signal_id) for g in groups for camera_id, c in g.seen.items()]
    assert len(used) == len(set(used))
    assert all(len(g.seen) >= 2 for g in groups)
    assert [g.time_s for g in groups] == sorted(g.time_s for g in groups)


def test_an_ambiguous_clock_is_warned_of_with_the_other_offsets():
    lights = ("red", "green")
    seen = {
        camera_id: [
            SignalChange(camera_id, "s", round((10.0 + 20.0 * k - offset_s) * 1e9), *lights, 1.0, 10_000_000)
            for k in range(first, first + 4)
        ]
        for camera_id, offset_s, first in (("a", 0.0, 0), ("b", 3.0, 0))
    }
    document = sync_document(seen, estimate_clocks(seen, "a", 50.0))
    [caution] = ambiguities(document)
    assert caution.code == "ambiguous_clock"
    assert "+23.00 s (100%)" in caution.message
    assert caution.details["camera"] == "b"
    assert caution.details["offset_s"] == pytest.approx(3.0, abs=0.01)
    assert pytest.approx(-17.0, abs=0.01) in caution.details["alternatives_s"]
    assert {other.score for other in document.cameras["b"].alternatives} == {1.0}


def test_document_holds_what_the_figures_need():
    changes, _, _ = record(np.random.default_rng(9))
    result = estimate_clocks(changes, "c0")
    document = json.loads(sync_document(changes, result).model_dump_json())
    assert list(document["cameras"]) == ["c0", "c1", "c2", "c3"]
    for camera_id, camera in document["cameras"].items():
        assert camera["changes"] == len(document["changes"][camera_id])
        assert camera["matched"] == sum(c["matched"] for c in document["changes"][camera_id])
        if camera_id != "c0":
            assert camera["rms_after_s"] < 0.06
    assert len(document["groups"]) == len(result.groups)
    assert {o["camera"] for o in document["groups"][0]["observations"]} == set(changes)


def test_a_minute_and_a_half_of_coarse_changes_says_little_of_the_drift():
    """Crystals differ by tens of millionths; times that are known to 23 ms alone would say hundreds of them."""
    rng = np.random.default_rng(5)
    found_ppm = []
    for _ in range(8):
        changes, _, _ = record(rng, duration_s=100.0, signals=2)
        clocks = estimate_clocks(changes, "c0").clocks
        found_ppm += [1e6 * clocks[f"c{k}"].drift for k in range(1, 4)]
    assert np.sqrt(np.mean(np.square(found_ppm))) < 60


@pytest.mark.parametrize("start_s", [298.26, 299.3, 300.08])
def test_every_cycle_is_a_candidate_where_a_camera_saw_most_of_them_coarsely(start_s):
    """A camera that saves a picture a second while little moves times changes to half a second then, and well later."""
    program = SignalProgram(cycle_s=22.0, offset_s=1.0)

    def seen(camera_id: str, begin_s: float, end_s: float) -> list[SignalChange]:
        found = []
        for at_s, phase, before, after in program.changes(begin_s, end_s):
            shown_s, half_ns = (np.floor(at_s) + 0.5, 500_000_000) if at_s < 300 else (at_s, 62_500_000)
            time_ns = round((shown_s - begin_s) * 1e9)
            found.append(SignalChange(camera_id, phase, time_ns, before, after, 0.95, half_ns))
        return found

    changes = {"a": seen("a", 0.0, 336.0), "b": seen("b", start_s, start_s + 36.0)}
    _, alignments = match_changes(changes, "a", 600.0, {"a": (0.0, 336.0), "b": (0.0, 36.0)})
    assert min(abs(offset_s - start_s) for offset_s in alignments["b"].open_s) < 0.05
