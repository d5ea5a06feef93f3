from pathlib import Path

import numpy as np
import pytest

from tests.signal_heads import CYCLE, GERMAN_CYCLE, LIT, record, sequence, truth
from wibam_core.errors import InputError
from wibam_core.site import SignalRegion
from wibam_core.sync.changes import RegionWatcher, detect_changes


def region(size=(10, 26), margin=1.0):
    return SignalRegion(id="s", region=(20 - margin, 16 - margin, size[0] + 2 * margin, size[1] + 2 * margin))


def check(starts, duration_s=45.0, size=(10, 26), min_confidence=0.3, margin=1.0, **kwargs):
    """The changes are the true ones, each inside its own interval."""
    found = detect_changes(record(starts, duration_s, size=size, **kwargs), "cam", [region(size, margin)], 0.4)
    expected = truth(starts, duration_s)
    assert [(c.before, c.after) for c in found] == [(before, after) for _, before, after in expected]
    for change, (t, _, _) in zip(found, expected, strict=True):
        assert abs(change.time_ns / 1e9 - t) <= change.half_interval_ns / 1e9 + 1e-6
        assert change.confidence >= min_confidence
    return found


def test_plain_cycle_gives_every_change_within_one_frame():
    found = check(sequence(CYCLE, 45, 4.2))
    assert len(found) == 6
    assert {c.half_interval_ns for c in found} == {40_000_000}
    assert {(c.camera_id, c.signal_id) for c in found} == {("cam", "s")}


@pytest.mark.parametrize("size", [(6, 14), (5, 12), (18, 50)])
def test_small_and_large_heads(size):
    check(sequence(CYCLE, 45, 2.0), size=size)


def test_horizontal_head():
    check(sequence(CYCLE, 45, 2.0), size=(28, 9), horizontal=True)


def test_red_amber_before_green():
    found = check(sequence(GERMAN_CYCLE, 45, 2.0))
    assert ("red", "red_amber") in {(c.before, c.after) for c in found}


def test_compressed_noisy_small_head():
    check(sequence(CYCLE, 45, 5.0), size=(7, 17), noise=10.0, jpeg=35)


def test_dim_lamps_by_day():
    check(sequence(CYCLE, 45, 5.0), lamp_gain=lambda t: 0.55, scene=(160, 165, 160), noise=5.0)


def test_night_with_halo_and_clipped_cores():
    bright = {"red": (190, 190, 255), "amber": (170, 235, 255), "green": (255, 255, 200)}
    check(sequence(CYCLE, 45, 5.0), colours=bright, scene=(8, 8, 8), noise=3.0)


def test_reddish_amber_is_told_from_red_by_its_place():
    check(sequence(CYCLE, 45, 5.0), colours={**LIT, "amber": (35, 70, 245)})


def test_exposure_steps_make_no_change():
    check(sequence(CYCLE, 45, 5.0), gain=lambda t: 0.5 if 14 < t % 20 < 18 else 1.1)


def test_flicker_of_led_lamps_makes_no_change():
    check(sequence(CYCLE, 45, 5.0), lamp_gain=lambda t: 0.08 + 0.92 * abs(np.sin(2 * np.pi * 0.9 * t)), fps=25)


@pytest.mark.parametrize("colour", [(60, 60, 60), (30, 30, 200), (40, 150, 230), (70, 170, 60), (230, 230, 230)])
@pytest.mark.parametrize("at_s", [8.0, 19.0])
def test_a_passing_truck_makes_no_change(colour, at_s):
    starts = sequence(CYCLE, 45, 5.0)

    def truck(t, image):
        right = int((t - at_s) / 0.4 * image.shape[1])
        left = int((t - at_s - 1.4) / 0.4 * image.shape[1])
        image[:, max(left, 0) : max(right, 0)] = colour

    check(starts, over=truck)


def test_a_change_behind_a_truck_is_less_certain():
    starts = sequence(CYCLE, 45, 5.0)
    hidden = truth(starts, 45)[2][0]

    def truck(t, image):
        if hidden - 0.6 < t < hidden + 0.5:
            image[:] = (70, 65, 60)

    found = check(starts, over=truck, min_confidence=0.01)
    assert found[2].half_interval_ns > 500_000_000
    assert found[2].confidence < 0.5 * found[1].confidence


def test_dropped_frames_widen_the_interval():
    starts = sequence(CYCLE, 45, 5.0)
    found = check(starts, dropped=0.5, seed=3)
    assert max(c.half_interval_ns for c in found) > 40_000_000


@pytest.mark.parametrize("fps", [6.0, 30.0])
def test_frame_rates(fps):
    check(sequence(CYCLE, 45, 5.0), fps=fps)


def test_sloppy_region_holds_its_head():
    check(sequence(CYCLE, 45, 5.0), margin=6)


def test_a_region_without_signal_gives_nothing():
    rng = np.random.default_rng(0)

    def traffic(t, image):
        if rng.random() < 0.2:
            image[:, :25] = [(40, 40, 220), (60, 200, 80), (40, 150, 250)][rng.integers(3)]

    frames = record([(-1.0, "off")], 30, over=traffic)
    assert detect_changes(frames, "cam", [SignalRegion(id="s", region=(0, 0, 15, 40))], 0.4) == []


def test_a_signal_that_never_changes_gives_nothing():
    assert detect_changes(record([(-1.0, "red")], 20), "cam", [region()], 0.4) == []


def test_a_head_that_is_dark_in_most_frames_needs_a_lower_share():
    starts = sequence(CYCLE, 45, 4.2)

    def flickering():
        """Two frames of three fall between the flashes of the LEDs."""
        for number, (time_ns, image) in enumerate(record(starts, 45)):
            yield time_ns, image if number % 3 == 0 else np.full_like(image, 20)

    assert detect_changes(flickering(), "cam", [region()], 0.4) == []
    found = detect_changes(flickering(), "cam", [region()], 0.2)
    assert [(c.before, c.after) for c in found] == [(before, after) for _, before, after in truth(starts, 45)]


def test_several_regions_in_one_pass_and_the_clearer_of_two_heads_speaks():
    starts = sequence(CYCLE, 30, 5.0)
    good, blind = region(), SignalRegion(id="s", region=(0, 0, 12, 14))
    other = SignalRegion(id="t", region=good.region)
    consumed = []

    def frames():
        for frame in record(starts, 30):
            consumed.append(frame[0])
            yield frame

    found = detect_changes(frames(), "cam", [blind, good, other], 0.4)
    expected = truth(starts, 30)
    assert sorted(c.signal_id for c in found) == ["s"] * len(expected) + ["t"] * len(expected)
    assert len(consumed) == len(set(consumed))
    assert [c.time_ns for c in found] == sorted(c.time_ns for c in found)


def test_a_region_outside_the_image_is_refused():
    with pytest.raises(InputError, match="signal s"):
        RegionWatcher(SignalRegion(id="s", region=(300, 10, 10, 20)), 200, 100)


@pytest.mark.assets
def test_real_junction_has_exactly_its_two_changes(assets: Path):
    from wibam_core.video.decode import decode

    signal = SignalRegion(id="s", region=(551, 180, 18, 50))
    found = detect_changes(decode(assets / "signals" / "junction_640x480_6fps.mp4"), "cam", [signal], 0.4)
    assert [(c.before, c.after) for c in found] == [("amber", "red"), ("red", "green")]
    frame_s = 1 / 6.0196
    assert found[0].time_ns / 1e9 == pytest.approx(2.5 * frame_s, abs=0.6 * frame_s)
    assert found[1].time_ns / 1e9 == pytest.approx(42.4, abs=0.1)
    assert min(c.confidence for c in found) > 0.8
