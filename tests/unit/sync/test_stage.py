from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.builders import corner_rig, site_of
from tests.signal_heads import CYCLE, record, sequence
from tests.stage_folders import StageFolders
from tests.unit.sync.test_traffic import drives, seen
from wibam_core.artifacts.catalogue import CALIBRATED_RIG, CHANGES, CLOCKS, PROBE
from wibam_core.clocks import ClockMap
from wibam_core.config import SyncConfig
from wibam_core.detection.boxes import Found
from wibam_core.documents.recordings import Probe
from wibam_core.errors import MissingCamera, NoSignalChange
from wibam_core.progress import silent
from wibam_core.site import Site
from wibam_core.stages import passing, sync
from wibam_core.video.encode import VideoWriter
from wibam_core.video.probe import probe
from wibam_core.video.recording import Recording

STARTS = {"cam1": 5.0, "cam2": 6.4, "cam3": 4.3}
SECONDS, SIZE = 40.0, (10, 26)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three recordings of one painted signal, started at different times of its cycle."""
    folder = tmp_path_factory.mktemp("recordings")
    for number, (camera_id, start_s) in enumerate(STARTS.items()):
        frames = record(sequence(CYCLE, SECONDS, start_s), SECONDS, size=SIZE, seed=number, noise=3.0)
        with VideoWriter(folder / f"{camera_id}.mp4", SIZE[0] + 40, SIZE[1] + 32, 12.5, crf=24) as writer:
            for time_ns, image in frames:
                writer.write(image, time_ns)
    return folder


def context_of(folder, output, region=(19, 15, 12, 28), told=None, recordings=None):
    site = site_of(corner_rig(3)).model_dump(mode="json")
    for camera in site["cameras"]:
        camera["signals"] = [{"id": "main", "region": region}] if region else []
    recordings = recordings or {camera_id: folder / f"{camera_id}.mp4" for camera_id in STARTS}
    listener = (lambda fraction, *a, **k: told.append(fraction)) if told is not None else (lambda *a, **k: None)
    folders = StageFolders(output)
    folders.give(PROBE, Probe(cameras={camera_id: probe(path) for camera_id, path in recordings.items()}))
    return folders.context("sync", Site.model_validate(site), recordings, progress=listener)


def test_recordings_are_put_on_one_clock(folder, tmp_path):
    told = []
    summary = sync.run(context_of(folder, tmp_path, told=told), SyncConfig(method="signals"))
    made = StageFolders(tmp_path)
    clocks = made.read(CLOCKS)
    assert list(clocks) == list(STARTS)
    assert clocks["cam1"] == ClockMap()
    for camera_id, start_s in STARTS.items():
        assert clocks[camera_id].offset_ns / 1e9 == pytest.approx(start_s - STARTS["cam1"], abs=0.045)
    assert clocks.errors["cam2"].offset_sd_ns < 40e6
    document = made.read(CHANGES)
    assert document.method == "signals"
    assert summary["matched_changes"] == len(document.groups) >= 4
    assert document.cameras["cam2"].rms_before_s == pytest.approx(1.4, abs=0.06)
    assert document.cameras["cam2"].rms_after_s < 0.06
    assert told[-1] == 1.0
    assert told == sorted(told)


def test_method_none_takes_the_clocks_as_they_are(folder, tmp_path):
    sync.run(context_of(folder, tmp_path), SyncConfig(method="none"))
    made = StageFolders(tmp_path)
    assert set(made.read(CLOCKS).values()) == {ClockMap()}
    assert made.read(CHANGES).method == "none"


def test_a_region_that_shows_no_signal_names_its_camera(folder, tmp_path):
    with pytest.raises(NoSignalChange, match="camera cam1") as error:
        sync.run(context_of(folder, tmp_path, region=(0, 0, 10, 14)), SyncConfig(method="signals"))
    assert "region" in error.value.hint
    assert not list((tmp_path / "sync").iterdir())


def test_a_camera_without_region_or_recording_is_named(folder, tmp_path):
    with pytest.raises(NoSignalChange, match="cam1 has no signal region"):
        sync.run(context_of(folder, tmp_path, region=None), SyncConfig(method="signals"))
    context = context_of(folder, tmp_path)
    del context.recordings["cam2"]
    with pytest.raises(MissingCamera, match="cam2"):
        sync.run(context, SyncConfig(method="signals"))


def test_a_camera_that_was_off_for_an_unknown_time_is_found_again(tmp_path):
    """The second camera's recording is two files that say nothing of when they were made: it was off for 8 s."""
    lasts_s = (9.0, 3.0, 10.0, 5.0, 3.0, 14.0, 13.0, 3.0, 7.0, 6.0, 3.0, 12.0)
    uneven = tuple((state, seconds) for (state, _), seconds in zip(CYCLE * 4, lasts_s, strict=True))
    parts = {
        "cam1.mp4": (0.0, 88.0), "cam2 (1).mp4": (2.0, 42.0), "cam2 (2).mp4": (52.0, 36.0), "cam3.mp4": (1.0, 87.0),
    }  # fmt: skip
    for number, (name, (start_s, seconds)) in enumerate(parts.items()):
        frames = record(sequence(uneven, seconds, start_s), seconds, size=SIZE, seed=number, noise=3.0)
        with VideoWriter(tmp_path / name, SIZE[0] + 40, SIZE[1] + 32, 12.5, crf=24) as writer:
            for time_ns, image in frames:
                writer.write(image, time_ns)
    recordings = {
        camera_id: Recording.at(*(tmp_path / name for name in parts if name.startswith(camera_id)))
        for camera_id in STARTS
    }
    sync.run(context_of(tmp_path, tmp_path / "out", recordings=recordings), SyncConfig(method="signals"))
    made = StageFolders(tmp_path / "out")
    [placed] = made.read(CHANGES).cameras["cam2"].segments
    assert placed.shift_s == pytest.approx(8.0, abs=0.08) and placed.sd_s < 0.08
    clock = made.read(CLOCKS)["cam2"]
    assert int(clock.to_reference_ns(20 * 10**9)) / 1e9 == pytest.approx(22.0, abs=0.08)
    assert int(clock.to_reference_ns(50 * 10**9)) / 1e9 == pytest.approx(60.0, abs=0.08)
    assert not made.read(CHANGES).cameras["cam2"].assumed_from_s


class MadeWays(passing.Passing):
    """Watches the lights; instead of searching for vehicles, it has ways that are made, of known times."""

    def __init__(self, seen_at):
        self.asked, self._seen_at = [], seen_at

    def of(self, context, infos):
        super().__init__(context, infos)
        return self

    def paths(self, rate_hz, progress, lights=None):
        self.asked.append((rate_hz, sorted(lights or {})))
        self.lights(lights or {}, progress)
        rng = np.random.default_rng(5)
        vehicles = [(0.2 * begin_s, *rest) for begin_s, *rest in drives(rng, 70)]
        rate_hz = rate_hz if rate_hz in self._seen_at else 0.5
        return {camera_id: seen(rng, vehicles, start_s, rate_hz=rate_hz) for camera_id, start_s in STARTS.items()}


@pytest.mark.parametrize(("seen_at", "asked"), [((2.5, 5.0), [2.5]), ((5.0,), [2.5, 5.0])])
def test_traffic_that_only_decides_between_cycles_is_watched_at_half_the_rate_first(
    folder, tmp_path, monkeypatch, seen_at, asked
):
    """In the second case, too few sightings of a way are left at half the rate."""
    made, told = MadeWays(seen_at), []
    monkeypatch.setattr(sync, "Passing", made.of)
    context = context_of(folder, tmp_path, told=told)
    StageFolders(tmp_path).give(CALIBRATED_RIG, corner_rig(3))
    sync.run(context, SyncConfig())
    # each recording is decoded once for both witnesses; the lights are not watched again
    assert made.asked == list(zip(asked, [sorted(STARTS), []], strict=False))
    document = StageFolders(tmp_path).read(CHANGES)
    assert document.method == "both" and document.cameras["cam2"].decided_by_traffic
    assert not any(camera.ambiguous for camera in document.cameras.values())
    clocks = StageFolders(tmp_path).read(CLOCKS)
    for camera_id, start_s in STARTS.items():
        mapped_s = int(clocks[camera_id].to_reference_ns(20 * 10**9)) / 1e9
        assert mapped_s == pytest.approx(20.0 + start_s - STARTS["cam1"], abs=0.045)
    assert told == sorted(told) and told[-1] == 1.0


def test_traffic_that_measures_is_watched_at_the_full_rate_alone(folder, tmp_path, monkeypatch):
    made = MadeWays((5.0,))
    monkeypatch.setattr(sync, "Passing", made.of)
    context = context_of(folder, tmp_path)
    StageFolders(tmp_path).give(CALIBRATED_RIG, corner_rig(3))
    sync.run(context, SyncConfig(method="traffic"))
    assert made.asked == [(5.0, [])]
    made = MadeWays((5.0,))
    monkeypatch.setattr(sync, "Passing", made.of)
    sync.run(context, SyncConfig(method="both"))
    assert made.asked == [(5.0, sorted(STARTS))]


class BrightDetector:
    """Finds what is bright."""

    looks = 0

    def detect(self, image):
        BrightDetector.looks += 1
        x, y, w, h = cv2.boundingRect((image.min(axis=2) > 128).astype(np.uint8))
        boxes = np.array([[x, y, x + w, y + h]], np.float64)
        return Found(boxes, np.ones(1), np.zeros(1, np.int64))


def test_what_was_seen_in_a_frame_is_kept_for_when_more_frames_are_asked_for(tmp_path, monkeypatch):
    monkeypatch.setattr(passing, "load_detector", lambda *_, **__: BrightDetector())
    monkeypatch.setattr(BrightDetector, "looks", 0)
    recording, size = tmp_path / "cam1.mp4", (640, 360)
    with VideoWriter(recording, *size, 10.0) as writer:
        for number in range(60):
            image = np.zeros((size[1], size[0], 3), np.uint8)
            image[170:200, 100 + 6 * number : 150 + 6 * number] = 255
            writer.write(image, number * 100_000_000)
    folders = StageFolders(tmp_path / "out")
    context = folders.context("sync", site_of(corner_rig(1)), {"cam1": Recording.at(recording)})
    folders.give(CALIBRATED_RIG, corner_rig(1))
    infos = {"cam1": probe(recording)}
    watched = passing.Passing(context, infos)
    assert len(watched.paths(2.5, silent)["cam1"]) == 1 and BrightDetector.looks == 15
    [again] = watched.paths(5.0, silent)["cam1"]
    assert BrightDetector.looks == 30
    [fresh] = passing.Passing(context, infos).paths(5.0, silent)["cam1"]
    assert BrightDetector.looks == 60 and len(fresh) == 30
    for name, values in vars(fresh).items():
        np.testing.assert_array_equal(getattr(again, name), values)


@pytest.mark.parametrize("is_lost", [False, True])
def test_a_clock_that_was_set_is_told_from_a_camera_that_was_off(tmp_path, is_lost):
    """Half way the second camera's stamps go on 25 s later: those frames are missing, or a time server spoke."""
    lasts_s = (9.0, 3.0, 10.0, 5.0, 3.0, 14.0, 13.0, 3.0, 7.0, 6.0, 3.0, 12.0)
    uneven = tuple((state, seconds) for (state, _), seconds in zip(CYCLE * 4, lasts_s, strict=True))
    seconds, set_s, jump_s = 100.0, 48.0, 25.0
    starts = {"cam1": 0.0, "cam2": 2.0, "cam3": 1.0}
    for number, (camera_id, start_s) in enumerate(starts.items()):
        frames = record(sequence(uneven, seconds, start_s), seconds, size=SIZE, seed=number, noise=3.0)
        with VideoWriter(tmp_path / f"{camera_id}.mp4", SIZE[0] + 40, SIZE[1] + 32, 12.5, crf=24) as writer:
            for time_ns, image in frames:
                later = camera_id == "cam2" and time_ns > set_s * 1e9
                if later and is_lost and time_ns < (set_s + jump_s) * 1e9:
                    continue
                writer.write(image, time_ns + (round(jump_s * 1e9) if later and not is_lost else 0))
    context = context_of(tmp_path, tmp_path / "out", recordings={c: tmp_path / f"{c}.mp4" for c in starts})
    warned = []
    context = replace(context, warned=warned.append)
    sync.run(context, SyncConfig(method="signals"))
    made = StageFolders(tmp_path / "out")
    clock, codes = made.read(CLOCKS)["cam2"], [warning.code for warning in warned]
    shift_s = 0.0 if is_lost else -jump_s
    assert int(clock.to_reference_ns(20 * 10**9)) / 1e9 == pytest.approx(22.0, abs=0.08)
    assert int(clock.to_reference_ns(90 * 10**9)) / 1e9 == pytest.approx(92.0 + shift_s, abs=0.08)
    assert ("clock_set" in codes) is not is_lost
    if not is_lost:
        [placed] = made.read(CHANGES).cameras["cam2"].segments
        assert placed.shift_s == pytest.approx(-jump_s, abs=0.08)
