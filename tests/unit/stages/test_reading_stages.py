"""The stages that read recordings, on real H.264 files: preflight and frames."""

from __future__ import annotations

import itertools
import json
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from av.video.frame import VideoFrame

from tests.unit.stages.reading import HEIGHT, STEP_NS, WIDTH, Run, S, record, site, true_time_ns
from wibam_core.artifacts import catalogue
from wibam_core.clocks import ClockMap, ClockPiece
from wibam_core.config import FramesConfig, PreflightConfig
from wibam_core.detection.background import BackgroundFrames
from wibam_core.errors import (
    DiskFull,
    InputError,
    InvalidLabels,
    MissingCamera,
    NoOverlap,
    UnreadableVideo,
)
from wibam_core.formats.clocks import Clocks
from wibam_core.stages import frames, preflight
from wibam_core.video import decode
from wibam_core.video.picture import Orientation
from wibam_core.video.recording import Recording

CLOCKS = {
    "a": ClockMap(),
    "b": ClockMap(offset_ns=-1_237_000_000, drift=4e-4),
    "c": ClockMap(offset_ns=733_000_001, drift=-2e-4),
}


@pytest.fixture
def three(tmp_path: Path) -> Run:
    """a: 1–4 s with 4 frames dropped around 2 s; b: 0–3 s; c: 1.48–3.96 s."""
    videos = tmp_path / "videos"
    videos.mkdir()
    recordings = {
        "a": record(videos / "a.mp4", CLOCKS["a"], S, 4 * S, frozenset(range(23, 27))),
        "b": record(videos / "b.mp4", CLOCKS["b"], 0, 3 * S),
        "c": record(videos / "c.mp4", CLOCKS["c"], 37 * STEP_NS, 4 * S - 1),
    }
    folder = tmp_path / "stages"
    folder.mkdir()
    return Run(folder, recordings)


def test_preflight_writes_what_the_recordings_are(three: Run) -> None:
    summary = three.preflight(min_overlap_s=2)
    probed = three.read(catalogue.PROBE).cameras
    assert list(probed) == ["a", "b", "c"]
    assert (probed["b"].codec, probed["b"].width_px, probed["b"].height_px) == ("h264", WIDTH, HEIGHT)
    assert probed["b"].first_ns == pytest.approx(int(CLOCKS["b"].to_local_ns(0)), abs=6_000)
    assert summary["shortest_s"] == pytest.approx(2.5 + 0.04, abs=0.03)
    assert three.warnings == []
    times = three.read(catalogue.TIMESTAMPS)
    assert {camera_id: len(of_camera) for camera_id, of_camera in times.items()} == {"a": 72, "b": 76, "c": 63}
    assert {id_: (info.first_ns, info.last_ns) for id_, info in probed.items()} == {
        camera_id: (of_camera[0], of_camera[-1]) for camera_id, of_camera in times.items()
    }
    json.dumps(summary)


def test_preflight_names_every_camera_without_a_recording(three: Run) -> None:
    run = Run(three.root, three.recordings, ("a", "north", "b", "south"))
    with pytest.raises(MissingCamera, match="north, south"):
        run.preflight()


def test_preflight_names_the_camera_of_a_broken_recording(three: Run) -> None:
    three.recordings["b"].write_text("no film")
    with pytest.raises(UnreadableVideo, match=r"camera b: b\.mp4 is not a video"):
        three.preflight(min_overlap_s=0)


def test_preflight_says_that_two_cameras_have_one_recording(three: Run) -> None:
    three.recordings["c"].write_bytes(three.recordings["a"].read_bytes())
    three.preflight(min_overlap_s=1)
    [warning] = three.warnings
    assert (warning.code, warning.details["camera"], warning.details["other"]) == ("same_recording", "c", "a")
    assert "the one of camera a" in warning.message


def test_preflight_refuses_another_size_than_the_calibrations(three: Run) -> None:
    three.site = site(("a", "b", "c"), 1280, 720)
    with pytest.raises(InputError, match="camera a is 128x72 px, but the site says 1280x720 px"):
        three.preflight()


def test_preflight_refuses_recordings_too_short_to_overlap(three: Run) -> None:
    with pytest.raises(NoOverlap, match=r"camera a lasts 3\.0 s.* at least 5 s"):
        three.preflight(min_overlap_s=5)


def test_frames_show_the_same_moment_in_every_camera(three: Run) -> None:
    three.preflight(min_overlap_s=1)
    summary, store = three.frames(CLOCKS, rate_hz=12.5)
    period_ns = 80_000_000
    times = [frame_set.time_ns for frame_set in store.frame_sets]
    assert times == list(range(13 * period_ns, 50 * period_ns, period_ns))  # c ends at 3.96 s
    for frame_set in store.frame_sets:
        for camera_id, frame_time_ns in frame_set.frame_times_ns.items():
            assert abs(frame_time_ns - frame_set.time_ns) <= 40_000_000
            shown_ns = true_time_ns(store.image(camera_id, frame_set.time_ns))
            assert shown_ns == pytest.approx(frame_time_ns, abs=0.55 * STEP_NS)
    assert summary["instants"] == len(times)
    assert summary["frames"] == {c: sum(c in s.frame_times_ns for s in store.frame_sets) for c in "abc"}
    assert store.native_size("a") == (WIDTH, HEIGHT)
    json.dumps(summary)


def test_frames_that_were_dropped_or_not_recorded_are_absent(three: Run) -> None:
    three.preflight(min_overlap_s=1)
    _, store = three.frames(CLOCKS, rate_hz=12.5)
    without_a = {s.time_ns for s in store.frame_sets if "a" not in s.frame_times_ns}
    # frames 23 to 26 are those at 1.92 to 2.04 s: nothing is within 40 ms of 1.92 (but 1.88 is) and 2.0 s
    assert without_a == {2_000_000_000}
    assert all("b" not in s.frame_times_ns for s in store.frame_sets if s.time_ns > 3_040_000_000)
    assert all("c" not in s.frame_times_ns for s in store.frame_sets if s.time_ns < 1_430_000_000)


def test_a_damaged_frame_is_replaced_by_the_nearest_sound_one(three: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Packets tell of all frames; which of them decode is only known afterwards."""
    three.preflight(min_overlap_s=1)
    gone = {three.read(catalogue.TIMESTAMPS)["b"][number] for number in (50, 51, 52)}  # b shows 2.0 to 2.08 s

    def damaged(recording: Recording, threads: int) -> Iterator[tuple[int, VideoFrame, Orientation]]:
        in_b = recording.files[0].path.stem == "b"
        return (frame for frame in sound(recording, threads) if not in_b or frame[0] not in gone)

    sound = decode._frames
    monkeypatch.setattr(decode, "_frames", damaged)
    summary, store = three.frames(CLOCKS, rate_hz=12.5)
    shown = {s.time_ns: round(true_time_ns(store.image("b", s.time_ns)) / STEP_NS) for s in store.frame_sets
             if "b" in s.frame_times_ns}  # fmt: skip
    assert [shown[time_ns] for time_ns in (1_920_000_000, 2_000_000_000, 2_080_000_000)] == [48, 49, 53]
    assert set(store.damaged_ns("b")) == gone
    assert summary["damaged"] == {"a": 0, "b": 3, "c": 0}
    assert [(warning.code, warning.details["camera"]) for warning in three.warnings] == [("frames_damaged", "b")]


def test_frames_of_the_background_stay_whatever_the_clocks_are(three: Run) -> None:
    three.preflight(min_overlap_s=0)
    times_ns = three.read(catalogue.TIMESTAMPS)
    later = {**CLOCKS, "b": ClockMap(CLOCKS["b"].offset_ns + S // 7, -1e-4)}
    shown = []
    for clocks, rate_hz in ((CLOCKS, 12.5), (later, 1.0)):
        _, store = three.frames(clocks, rate_hz=rate_hz)
        of_camera = {id_: BackgroundFrames(times_ns[id_], store.stored_ns(id_), 1.0) for id_ in "abc"}
        shown.append({id_: [frames.of_block(block) for block in range(3)] for id_, frames in of_camera.items()})
    assert shown[0] == shown[1]
    count = {camera_id: sum(map(len, of_block)) for camera_id, of_block in shown[0].items()}
    assert count["b"] == count["c"] == 32
    assert count["a"] < 32  # some were dropped


def test_one_camera_alone_keeps_all_its_instants(three: Run) -> None:
    run = Run(three.root, {"b": three.recordings["b"]})
    run.preflight(min_overlap_s=1)
    _, store = run.frames({"b": CLOCKS["b"]}, rate_hz=5.0)
    assert [s.time_ns for s in store.frame_sets] == list(range(0, 3 * S + 1, 200_000_000))


def test_frames_wider_than_wanted_are_shrunk_once(three: Run) -> None:
    three.preflight(min_overlap_s=1)
    _, store = three.frames(CLOCKS, rate_hz=2.5, width_px=64)
    assert (store.size("a"), store.native_size("a")) == ((64, 36), (WIDTH, HEIGHT))


def test_frames_of_recordings_that_do_not_overlap_are_refused(three: Run) -> None:
    three.preflight(min_overlap_s=1)
    apart = {"a": ClockMap(), "b": ClockMap(100 * S), "c": ClockMap(-100 * S)}
    with pytest.raises(NoOverlap, match=r"they span a 1\.0 to 4\.0 s; b") as caught:
        three.frames(apart)
    assert caught.value.details["spans_ns"]["a"][0] == S


def test_a_camera_that_shares_no_time_with_the_others_is_named(three: Run) -> None:
    three.preflight(min_overlap_s=1)
    with pytest.raises(NoOverlap, match=r"camera c shares no time with any other.*c 1001\.5 to 1004\.0 s") as caught:
        three.frames({**CLOCKS, "c": ClockMap(CLOCKS["c"].offset_ns + 1000 * S, CLOCKS["c"].drift)})
    assert caught.value.details["cameras"] == ["c"]
    assert "remove it from the site" in caught.value.hint


@pytest.mark.parametrize("camera_id", ["b", "c"])
def test_a_camera_that_shares_less_than_the_least_time_is_named(three: Run, camera_id: str) -> None:
    """Every recording is longer than 2 s, but the clocks leave one of them 0.5 s together with the others."""
    three.preflight(min_overlap_s=2)
    shift_ns = {"b": -3 * S // 2, "c": 2 * S + S // 50}[camera_id]
    clocks = {**CLOCKS, camera_id: ClockMap(CLOCKS[camera_id].offset_ns + shift_ns, CLOCKS[camera_id].drift)}
    with pytest.raises(NoOverlap, match=rf"camera {camera_id} shares only 0\.\d s .*at least 2 s") as caught:
        three.frames(clocks)
    assert caught.value.details["shared_s"] < 1
    assert "preflight.min_overlap_s" in caught.value.hint


def test_recordings_of_just_the_least_time_are_enough(three: Run) -> None:
    """Frames from 0 to 1.48 s, the last of them shown for 40 ms."""
    folder = three.root.parent / "videos"
    run = Run(three.root, {id_: record(folder / f"{id_}2.mp4", ClockMap(), 0, 37 * STEP_NS) for id_ in "ab"})
    run.preflight(min_overlap_s=1.5)
    summary, _ = run.frames({"a": ClockMap(), "b": ClockMap()})
    assert summary["frames"]["a"] == summary["frames"]["b"] > 0


def test_a_camera_without_a_frame_at_the_common_instants_is_an_error(three: Run) -> None:
    """All share a moment, but nothing within reach of a common instant was recorded by b."""
    three.recordings["b"] = record(
        three.root.parent / "videos" / "gap.mp4", ClockMap(), 0, 95 * STEP_NS, frozenset(range(4, 95))
    )
    three.preflight(min_overlap_s=1)
    clocks = {**CLOCKS, "b": ClockMap()}
    with pytest.raises(NoOverlap, match="camera b has no frame at any of the 3 common instants") as caught:
        three.frames(clocks, rate_hz=1.0)
    assert "remove it" in caught.value.hint
    with pytest.raises(InputError):
        three.read(catalogue.FRAMES)


def test_a_segment_that_lies_elsewhere_than_assumed_gives_no_frame_to_an_instant_between(three: Run) -> None:
    """The last frames of b, from 2 s on, were recorded 1 s later than its stamps say: from 2 to 3 s it was off."""
    folder = three.root.parent / "videos"
    run = Run(three.root, {id_: record(folder / f"{id_}2.mp4", ClockMap(), 0, 4 * S) for id_ in "ab"})
    run.preflight(min_overlap_s=1)
    _, store = run.frames({"a": ClockMap(), "b": ClockMap(pieces=(ClockPiece(2 * S, S),))})
    seen = {s.time_ns: s.local_times_ns["b"] for s in store.frame_sets if "b" in s.local_times_ns}
    for instant_ns, local_ns in seen.items():
        off_ns = 0 if local_ns < 2 * S else S
        assert abs(local_ns + off_ns - instant_ns) <= STEP_NS
        assert not 2 * S + STEP_NS < instant_ns < 3 * S - STEP_NS
    assert min(seen) < 2 * S
    assert max(seen) > 3 * S


def test_preflight_refuses_labels_that_cannot_be_used(three: Run, tmp_path: Path) -> None:
    labels = tmp_path / "labels.parquet"
    labels.write_bytes(bytes(range(256)))
    with pytest.raises(InvalidLabels, match="neither Parquet nor JSON"):
        preflight.run(three.of("preflight", assets={"labels": labels}), PreflightConfig(min_overlap_s=1))


def test_preflight_counts_the_labelled_instants(three: Run, tmp_path: Path) -> None:
    labels = tmp_path / "labels.json"
    labels.write_text('{"labels": [], "empty_instants": [40, 80]}')
    context = three.of("preflight", assets={"labels": labels})
    assert preflight.run(context, PreflightConfig(min_overlap_s=1))["labelled_instants"] == 2


def test_frames_stop_when_their_progress_is_refused(three: Run) -> None:
    three.preflight(min_overlap_s=1)
    three.give(catalogue.CLOCKS, Clocks(CLOCKS))

    def cancel(fraction: float, message: str = "", **figures: float) -> None:
        raise InterruptedError("stopped")

    with pytest.raises(InterruptedError):
        frames.run(three.of("frames", progress=cancel), FramesConfig(rate_hz=25))
    with pytest.raises(InputError):
        three.read(catalogue.FRAMES)


def test_frames_that_the_disk_will_not_hold_are_refused_early(three: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    three.preflight(min_overlap_s=1)
    three.give(catalogue.CLOCKS, Clocks(CLOCKS))
    asked, converted = threading.Event(), itertools.count()
    convert = decode.to_bgr

    def to_bgr(frame: VideoFrame, *how: Any) -> np.ndarray:
        if next(converted) > 60:  # the last frames wait until the disk was looked at
            asked.wait(20)
        return convert(frame, *how)

    def disk_usage(folder: Path) -> SimpleNamespace:
        asked.set()
        return SimpleNamespace(free=1000)

    monkeypatch.setattr(decode, "to_bgr", to_bgr)
    monkeypatch.setattr(shutil, "disk_usage", disk_usage)
    with pytest.raises(DiskFull, match=r"0\.00 GB left"):
        frames.run(three.of("frames"), FramesConfig(rate_hz=25))
    with pytest.raises(InputError):
        three.read(catalogue.FRAMES)
