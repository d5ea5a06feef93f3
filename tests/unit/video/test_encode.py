from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.video.decode import decode
from wibam_core.video.encode import TICKS_PER_S, VideoWriter, ticks_from_ns
from wibam_core.video.source import ns_from_pts

HALF_TICK_NS = 1e9 / TICKS_PER_S / 2


def checker(width: int, height: int, shift: int) -> np.ndarray:
    """A smooth picture with a moving bright block, (height, width, 3)."""
    image = np.full((height, width, 3), (60, 120, 90), np.uint8)
    image[height // 4 : height // 2, 4 + shift : 24 + shift] = (30, 40, 220)
    return image


def times_with_gap(start_ns: int = 1_234_567_891, frames: int = 40) -> list[int]:
    """25 fps from an odd start, with frames 17 to 21 dropped."""
    return [start_ns + i * 40_000_003 for i in range(frames) if not 17 <= i <= 21]


def write(path: Path, times_ns: list[int], width: int = 96, height: int = 64, crf: int = 20) -> Path:
    with VideoWriter(path, width, height, 25.0, crf) as writer:
        for i, time_ns in enumerate(times_ns):
            writer.write(checker(width, height, i), time_ns)
    return path


@pytest.mark.parametrize(("width", "height"), [(96, 64), (97, 64), (96, 63), (97, 63), (130, 70)])
def test_timestamps_and_pictures_survive_the_file(tmp_path: Path, width: int, height: int) -> None:
    times = times_with_gap()
    frames = list(decode(write(tmp_path / "a.mp4", times, width, height)))
    assert len(frames) == len(times)
    assert max(abs(got - want) for (got, _), want in zip(frames, times, strict=True)) <= HALF_TICK_NS + 1
    for i, (_, image) in enumerate(frames):
        assert image.shape == (height, width, 3)
        assert np.abs(image.astype(int) - checker(width, height, i)).mean() < 4


def test_first_timestamp_is_kept_to_the_tick_and_late_ones_stay_exact(tmp_path: Path) -> None:
    hour_ns = 3_600 * 10**9
    times = [7 * hour_ns + 123_456_789, 7 * hour_ns + 163_456_789, 9 * hour_ns + 11]
    got = [time_ns for time_ns, _ in decode(write(tmp_path / "a.mp4", times))]
    assert got == [ns_from_pts(ticks_from_ns(t), Fraction(1, TICKS_PER_S)) for t in times]


def test_same_frames_give_the_same_bytes(tmp_path: Path) -> None:
    first, second = (write(tmp_path / name, times_with_gap()) for name in ("a.mp4", "b.mp4"))
    assert first.read_bytes() == second.read_bytes()


def test_convention_encoder_settings_are_reproducible(tmp_path: Path) -> None:
    """x264 writes its settings into the file; its macroblock tree makes one encoding in ten differ, at random."""
    settings = write(tmp_path / "a.mp4", times_with_gap()).read_bytes()
    assert b" mbtree=0" in settings
    assert b" threads=1 " in settings


@pytest.mark.parametrize("width", [64, 65])
def test_colours_are_not_shifted(tmp_path: Path, width: int) -> None:
    path = tmp_path / "a.mp4"
    colours = [(20, 20, 20), (128, 128, 128), (240, 240, 240), (40, 90, 200), (200, 90, 40)]
    with VideoWriter(path, width, 48, 25.0, 4) as writer:
        for i, colour in enumerate(colours):
            writer.write(np.full((48, width, 3), colour, np.uint8), i * 40_000_000)
    for colour, (_, image) in zip(colours, decode(path), strict=True):
        assert np.abs(image.mean((0, 1)) - colour).max() < 2.5


def test_file_is_h264_in_mp4(tmp_path: Path) -> None:
    with av.open(str(write(tmp_path / "a.mp4", times_with_gap()))) as container:
        stream = container.streams.video[0]
        assert (container.format.name.split(",")[1], stream.codec_context.name) == ("mp4", "h264")
        assert (stream.time_base, stream.pix_fmt) == (Fraction(1, TICKS_PER_S), "yuv420p")


def test_crf_trades_size_for_quality(tmp_path: Path) -> None:
    fine, coarse = (
        write(tmp_path / "a.mp4", times_with_gap(), crf=10),
        write(tmp_path / "b.mp4", times_with_gap(), crf=40),
    )
    assert fine.stat().st_size > coarse.stat().st_size


def test_wrong_frames_are_refused(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "a.mp4", 96, 64, 25.0) as writer:
        writer.write(checker(96, 64, 0), 40_000_000)
        with pytest.raises(ValueError, match="does not follow"):
            writer.write(checker(96, 64, 1), 40_000_000)
        with pytest.raises(ValueError, match="more than an MP4"):
            writer.write(checker(96, 64, 1), 24 * 3_600 * 10**9)
        with pytest.raises(ValueError, match="shape"):
            writer.write(checker(98, 64, 1), 80_000_000)
    with pytest.raises(ValueError, match="cannot encode"):
        VideoWriter(tmp_path / "b.mp4", 0, 64, 25.0)


@given(st.integers(0, 10**18))
def test_law_ticks_are_nearest(time_ns: int) -> None:
    back = ns_from_pts(ticks_from_ns(time_ns), Fraction(1, TICKS_PER_S))
    assert abs(back - time_ns) <= HALF_TICK_NS + 1


@given(
    st.integers(-(10**12), 10**12), st.sampled_from([Fraction(1, 90_000), Fraction(1001, 30_000), Fraction(1, 1000)])
)
def test_law_ns_from_pts_is_the_nearest_integer(pts: int, time_base: Fraction) -> None:
    assert abs(ns_from_pts(pts, time_base) - pts * time_base * 10**9) <= Fraction(1, 2)
