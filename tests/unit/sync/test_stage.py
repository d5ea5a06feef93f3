import pytest

from tests.builders import corner_rig, site_of
from tests.signal_heads import CYCLE, record, sequence
from tests.stage_folders import StageFolders
from wibam_core.artifacts.catalogue import CHANGES, CLOCKS, PROBE
from wibam_core.clocks import ClockMap
from wibam_core.config import SyncConfig
from wibam_core.documents.recordings import Probe
from wibam_core.errors import MissingCamera, NoSignalChange
from wibam_core.site import Site
from wibam_core.stages import sync
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
