"""What becomes of clocks where recordings have sound, too."""

import numpy as np
import pytest

from tests.builders import corner_rig
from tests.signal_heads import CYCLE, record, sequence
from tests.sounds import add_sound, of_camera, street
from tests.stage_folders import StageFolders
from tests.unit.sync.test_stage import SIZE, context_of
from tests.unit.sync.test_traffic import SPAN, drives, fixed_cycle, seen
from wibam_core.artifacts.catalogue import CALIBRATED_RIG, CHANGES, CLOCKS
from wibam_core.clocks import SignalChange
from wibam_core.config import SyncConfig
from wibam_core.errors import UnknownClock
from wibam_core.stages import sync
from wibam_core.sync.document import doubts, sync_document
from wibam_core.sync.hearing import SoundAlignment
from wibam_core.sync.sound_pairs import sound_cautions
from wibam_core.sync.witnesses import synchronise
from wibam_core.video.encode import VideoWriter

SPANS = {"a": SPAN, "b": SPAN, "c": SPAN}


def sound(first, second, offset_s, strength=12.0, contrast=2.5):
    return SoundAlignment(first, second, 90.0 + offset_s, 90.0, 0.0, strength, contrast, 0.6 * contrast, 0.1)


def of_two(**options):
    spans = {camera_id: SPANS[camera_id] for camera_id in ("a", "b")}
    changes = {"a": fixed_cycle("a", 0.0), "b": fixed_cycle("b", 47.0)}
    return changes, synchronise(spans, "a", changes=changes, **options)


def documented(changes, found):
    return sync_document(
        changes, found.result, found.traffic, found.disagreeing, sounds=found.sounds, by_sound=found.by_sound
    )


def offset_s(found, camera_id="b"):
    return found.result.clocks[camera_id].offset_ns / 1e9


@pytest.mark.parametrize("heard_s", [46.7, 47.2])
def test_sound_chooses_between_whole_cycles_and_moves_nothing(heard_s):
    changes, found = of_two(sounds=[sound("a", "b", heard_s)])
    assert not found.is_ambiguous and found.by_sound == ("b",)
    assert offset_s(found) == pytest.approx(47.0, abs=0.05)
    document = documented(changes, found)
    assert document.cameras["b"].decided_by_sound and not document.cameras["b"].decided_by_traffic
    [pair] = document.sound
    assert pair.agrees and pair.residual_s == pytest.approx(heard_s - offset_s(found), abs=0.01)
    assert not sound_cautions(document)


def test_sound_that_is_not_clear_chooses_nothing():
    changes, found = of_two(sounds=[sound("a", "b", 47.0, contrast=1.1)])
    assert found.is_ambiguous and not found.by_sound
    assert offset_s(found) == offset_s(of_two()[1])
    assert documented(changes, found).sound[0].agrees is None


def test_sound_that_means_none_of_the_cycles_chooses_nothing_and_says_so():
    changes, found = of_two(sounds=[sound("a", "b", 38.0)])
    assert found.is_ambiguous and not found.by_sound
    document = documented(changes, found)
    [caution] = sound_cautions(document)
    assert caution.code == "sound_disagrees" and caution.details["cameras"] == ["a", "b"]
    assert "+38.00 s" in caution.message


def test_sound_decides_over_a_camera_whose_clock_is_known():
    """Only b and c have sound; b's clock follows from lights that do not repeat themselves."""
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(8, 25, 12))
    uneven = {
        camera_id: [
            SignalChange(camera_id, "s", round((t - start_s) * 1e9), "red", "green", 1.0, 20_000_000) for t in times
        ]
        for camera_id, start_s in (("a", 0.0), ("b", 12.0))
    }
    changes = {
        "a": [*uneven["a"], *fixed_cycle("a", 0.0, "t")],
        "b": uneven["b"],
        "c": fixed_cycle("c", -30.0, "t"),
    }
    assert synchronise(SPANS, "a", changes=changes).is_ambiguous
    found = synchronise(SPANS, "a", changes=changes, sounds=[sound("b", "c", -42.1)])
    assert found.by_sound == ("c",) and not found.is_ambiguous
    assert offset_s(found, "c") == pytest.approx(-30.0, abs=0.05)


def test_sound_confirms_or_contradicts_what_the_traffic_says_and_is_not_believed_against_it():
    rng = np.random.default_rng(2)
    vehicles = drives(rng)
    paths = {"a": seen(rng, vehicles, 0.0), "b": seen(rng, vehicles, 47.0)}
    for heard_s, agrees in ((47.2, True), (67.0, False)):
        changes, found = of_two(paths=paths, sounds=[sound("a", "b", heard_s)])
        assert offset_s(found) == pytest.approx(47.0, abs=0.05) and not found.by_sound
        document = documented(changes, found)
        assert document.sound[0].agrees is agrees and len(sound_cautions(document)) == (not agrees)
        assert document.cameras["b"].decided_by_traffic and not document.cameras["b"].decided_by_sound
        assert not doubts(document, None)


def test_sound_is_never_believed_alone():
    rng = np.random.default_rng(1)
    paths = {"a": seen(rng, drives(rng), 0.0), "b": seen(rng, drives(rng), 0.0)}
    with pytest.raises(UnknownClock, match=r"the sound says b against a \+47\.0 s, but is not believed alone"):
        synchronise({"a": SPAN, "b": SPAN}, "a", paths=paths, sounds=[sound("a", "b", 47.0)])


STARTS_S = {"cam1": 0.0, "cam2": 22.5, "cam3": 23.0}
LENGTH_S = 100.0


@pytest.fixture(scope="module")
def street_corner(tmp_path_factory):
    """Three cameras at a signal of a fixed cycle of 22 s; the third has no sound."""
    folder = tmp_path_factory.mktemp("street")
    places_m = np.array([camera.centre_m[:2] for camera in corner_rig(2).values()])
    heard = street(np.random.default_rng(8), LENGTH_S + 60.0, every_s=2.0, places_m=places_m)
    for number, (camera_id, start_s) in enumerate(STARTS_S.items()):
        frames = record(sequence(CYCLE, LENGTH_S, start_s % 22.0), LENGTH_S, size=SIZE, seed=number, noise=3.0)
        path = folder / f"{camera_id}.mp4"
        silent = folder / "silent.mp4" if number < len(heard) else path
        with VideoWriter(silent, SIZE[0] + 40, SIZE[1] + 32, 12.5, crf=24) as writer:
            for time_ns, image in frames:
                writer.write(image, time_ns)
        if number < len(heard):
            add_sound(silent, path, [of_camera(heard[number], start_s, LENGTH_S)])
    return folder


@pytest.mark.parametrize("listens", [True, False])
def test_recordings_with_sound_are_put_on_the_right_cycle(street_corner, tmp_path, listens):
    told = []
    recordings = {camera_id: street_corner / f"{camera_id}.mp4" for camera_id in STARTS_S}
    context = context_of(street_corner, tmp_path, told=told, recordings=recordings)
    StageFolders(tmp_path).give(CALIBRATED_RIG, corner_rig(3))
    sync.run(context, SyncConfig(method="signals", sound=listens))
    made = StageFolders(tmp_path)
    document, clocks = made.read(CHANGES), made.read(CLOCKS)
    assert document.cameras["cam3"].ambiguous  # nobody heard it
    assert document.cameras["cam2"].ambiguous is not listens
    assert told == sorted(told)
    if not listens:
        assert not document.sound and clocks["cam2"].offset_ns / 1e9 == pytest.approx(0.5, abs=0.06)
        return
    [pair] = document.sound
    assert (pair.first, pair.second) == ("cam1", "cam2") and pair.clear and pair.agrees
    assert pair.offset_s == pytest.approx(22.5, abs=0.15)
    assert clocks["cam2"].offset_ns / 1e9 == pytest.approx(22.5, abs=0.06)
    assert document.cameras["cam2"].decided_by_sound
