from __future__ import annotations

import gc
import os
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wibam_core.errors import UnreadableVideo
from wibam_core.geometry.pixels import shrunk_image
from wibam_core.video.decode import OnePass, decode, frames_nearest
from wibam_core.video.encode import VideoWriter
from wibam_core.video.picture import Orientation, to_bgr

FRAME_NS = 40_000_000


def numbered(i: int, width: int = 64, height: int = 48) -> np.ndarray:
    """A flat picture whose grey level tells its number (up to 30)."""
    return np.full((height, width, 3), 16 + 7 * i, np.uint8)


def number_of(image: np.ndarray) -> int:
    return round((float(image.mean()) - 16) / 7)


def write(path: Path, times_ns: list[int], **size: int) -> Path:
    with VideoWriter(path, size.get("width", 64), size.get("height", 48), 25.0, 12) as writer:
        for i, time_ns in enumerate(times_ns):
            writer.write(numbered(i, **size), time_ns)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[int]]:
    """20 frames from 1 s on, with 6 dropped after the eighth."""
    times = [10**9 + i * FRAME_NS for i in range(26) if not 8 <= i < 14]
    return write(tmp_path_factory.mktemp("video") / "a.mp4", times), times


def test_frames_come_with_their_own_times(recording: tuple[Path, list[int]]) -> None:
    path, times = recording
    frames = list(decode(path))
    assert [number_of(image) for _, image in frames] == list(range(20))
    assert [time_ns for time_ns, _ in frames] == pytest.approx(times, abs=5_556)


def test_several_threads_give_the_same_frames(recording: tuple[Path, list[int]]) -> None:
    path, _ = recording
    for (time_a, a), (time_b, b) in zip(decode(path), decode(path, threads=2), strict=True):
        assert time_a == time_b
        assert np.array_equal(a, b)


@settings(max_examples=40)
@given(
    targets=st.lists(st.integers(0, 3 * 10**9), min_size=1, max_size=30).map(sorted),
    tolerance_ns=st.integers(0, 200_000_000),
)
def test_law_nearest_selection_is_what_a_search_over_all_frames_finds(
    recording: tuple[Path, list[int]], targets: list[int], tolerance_ns: int
) -> None:
    path, _ = recording
    times = [time_ns for time_ns, _ in decode(path)]
    expected = []
    for target in targets:
        i = min(range(len(times)), key=lambda k: (abs(times[k] - target), k))
        if abs(times[i] - target) <= tolerance_ns:
            expected.append((target, times[i], i))
    got = frames_nearest(path, targets, tolerance_ns=tolerance_ns)
    assert [(f.target_ns, f.time_ns, number_of(f.image_bgr)) for f in got] == expected


def test_gap_gives_no_frame_and_ties_the_earlier(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mp4", [0, FRAME_NS, 10 * FRAME_NS])
    half = FRAME_NS // 2
    targets = [half, 5 * FRAME_NS, 10 * FRAME_NS, 11 * FRAME_NS]
    got = [(f.target_ns, f.time_ns) for f in frames_nearest(path, targets, tolerance_ns=half)]
    assert got == [(half, 0), (10 * FRAME_NS, 10 * FRAME_NS)]


def test_descending_targets_are_refused(recording: tuple[Path, list[int]]) -> None:
    with pytest.raises(ValueError, match="ascend"):
        list(frames_nearest(recording[0], [2 * 10**9, 10**9], tolerance_ns=FRAME_NS))


def test_only_frames_that_count_are_found(recording: tuple[Path, list[int]]) -> None:
    times = [time_ns for time_ns, _ in decode(recording[0])]
    one_pass = OnePass(recording[0], among={times[2], times[5]})
    found = [one_pass.nearest(times[number], 2 * FRAME_NS) for number in (1, 2, 3, 4, 9)]
    assert [None if frame is None else number_of(frame.image_bgr) for frame in found] == [2, 2, 2, 5, None]


def test_a_recording_is_opened_when_the_first_frame_is_asked_for(tmp_path: Path) -> None:
    one_pass = OnePass(tmp_path / "missing.mp4")
    with pytest.raises(UnreadableVideo, match="does not exist"):
        one_pass.nearest(0, 0)


def test_frames_are_shrunk_on_the_way(recording: tuple[Path, list[int]]) -> None:
    _, image = next(decode(recording[0], width_px=32))
    assert image.shape == (24, 32, 3)


def test_frames_are_given_back_once_they_were_seen(tmp_path: Path) -> None:
    """A recording's frames do not gather in memory until Python searches for garbage."""
    path = tmp_path / "a.mp4"
    with VideoWriter(path, 1280, 720, 25.0) as writer:
        for number in range(120):
            writer.write(np.full((720, 1280, 3), number, np.uint8), number * FRAME_NS)
    frame_bytes = 1280 * 720 * 3 // 2
    gc.collect()
    gc.disable()
    try:
        one_pass = OnePass(path)
        one_pass.pass_to(20 * FRAME_NS)
        before = resident_bytes()
        one_pass.finish()
        grown = resident_bytes() - before
    finally:
        gc.enable()
    assert grown < 30 * frame_bytes


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_damaged_frames_are_left_out(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    noise = rng.integers(0, 255, (40, 48, 64, 3), dtype=np.uint8)
    path = tmp_path / "a.mp4"
    with VideoWriter(path, 64, 48, 25.0) as writer:
        for i, image in enumerate(noise):
            writer.write(image, i * FRAME_NS)
    sound = list(decode(path))
    data = bytearray(path.read_bytes())
    at = data.index(b"mdat") + len(data) // 2
    data[at : at + 3000] = rng.integers(0, 255, 3000, dtype=np.uint8).tobytes()
    path.write_bytes(data)
    times = [time_ns for time_ns, _ in decode(path)]
    assert 5 < len(times) < len(sound)
    assert (np.diff(times) > 0).all()


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_convention_frames_are_turned_as_they_are_shown(tmp_path: Path, degrees: int) -> None:
    image = np.zeros((48, 64, 3), np.uint8)
    image[:24, :32] = 255  # top left is bright
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.set_display_rotation(degrees)
        for _ in range(3):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode(None))
    _, shown = next(decode(path))
    assert np.abs(shown.astype(int) - np.rot90(image, degrees // 90)).mean() < 5


@pytest.mark.parametrize("colour", [(20, 20, 20), (240, 240, 240), (40, 90, 200), (200, 90, 40)])
def test_colours_of_full_range_bt709_recordings(tmp_path: Path, colour: tuple[int, int, int]) -> None:
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": "4"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.colorspace, stream.codec_context.color_range = 1, 2
        bgr = av.VideoFrame.from_ndarray(np.full((48, 64, 3), colour, np.uint8), format="bgr24")
        for _ in range(2):
            frame = bgr.reformat(format="yuv420p", dst_colorspace=1, dst_color_range=2)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    _, image = next(decode(path))
    assert np.abs(image.mean((0, 1)) - colour).max() < 5


def test_opening_happens_at_the_first_frame_and_says_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(UnreadableVideo, match="does not exist"):
        next(decode(tmp_path / "missing.mp4"))


@pytest.mark.assets
def test_real_footage_decodes_whole(assets: Path) -> None:
    times = [time_ns for time_ns, _ in decode(assets / "footage" / "traffic.mp4", width_px=160)]
    assert len(times) == 480
    assert np.mean(np.diff(times)) == pytest.approx(1e9 * 125 / 2997, rel=1e-5)


@pytest.mark.parametrize("turned", [Orientation(), Orientation(transposed=True, mirrored_x=True)])
@pytest.mark.parametrize("matrix", [1, 5])  # BT.709, as most cameras have it, and BT.601
def test_a_frame_that_is_shrunk_while_it_is_converted_is_the_mean_of_its_pixels(
    turned: Orientation, matrix: int
) -> None:
    y, x = np.mgrid[0:144, 0:256]
    smooth = np.stack([90 + 60 * np.sin(x / 30), 120 + 50 * np.cos(y / 25), 60 + x / 2], axis=-1)
    noisy = smooth + np.random.default_rng(0).normal(0, 8, smooth.shape)
    stored = av.VideoFrame.from_ndarray(np.clip(noisy, 0, 255).astype(np.uint8), format="bgr24")
    frame = stored.reformat(format="yuv420p", dst_colorspace=matrix)
    frame.colorspace = matrix
    whole = to_bgr(frame, turned, None, None)
    width_px = whole.shape[1] * 3 // 8
    small = to_bgr(frame, turned, None, width_px)
    want = shrunk_image(whole, width_px)
    assert small.shape == want.shape
    assert np.abs(small.astype(int) - want).mean() < 1.5
    assert np.abs((small.astype(float) - want).mean(axis=(0, 1))).max() < 0.5
