"""What recordings are stored as: fields, older codecs, recorders' containers; and files that are no recordings."""

from pathlib import Path

import numpy as np
import pytest

from tests.field_recordings import write_dahua, write_fields
from tests.foreign_recordings import FPS, number_of, write
from wibam_core.errors import UnreadableVideo
from wibam_core.video.cautions import cautions_of
from wibam_core.video.decode import decode
from wibam_core.video.probe import measure, probe
from wibam_core.video.recording import Recording


def assert_read_whole(path: Path, count: int) -> list[str]:
    """Every frame is there at its own time; returns the codes of what is said."""
    info, times_ns = measure(Recording.at(path))
    decoded = [(time_ns, number_of(image)) for time_ns, image in decode(path)]
    assert [number for _, number in decoded] == [*range(count)]
    assert [time_ns for time_ns, _ in decoded] == times_ns.tolist()
    assert np.abs(times_ns - times_ns[0] - np.arange(count) * 1e9 / FPS).max() < 1e6  # Matroska rounds to 1 ms
    assert info.fps == pytest.approx(FPS, rel=0.002)
    return [caution.code for caution in cautions_of(info)]


@pytest.mark.parametrize(
    ("name", "together", "said"),
    [
        ("a.ts", False, ["interlaced"]),
        ("a.ts", True, ["interlaced"]),
        ("a.mkv", True, ["interlaced"]),
        ("a.mp4", False, ["interlaced"]),
        ("a.h264", False, ["no_clock", "interlaced"]),
    ],
)
def test_two_fields_are_one_frame(tmp_path: Path, name: str, together: bool, said: list[str]) -> None:
    """As camcorders record 1080i: a packet a field, the second with a stamp of its own or none."""
    assert assert_read_whole(write_fields(tmp_path / name, range(30), together=together), 30) == said


@pytest.mark.parametrize(
    ("name", "codec", "pixels"),
    [
        ("a.wmv", "wmv2", "yuv420p"),
        ("a.avi", "wmv1", "yuv420p"),
        ("a.avi", "msmpeg4", "yuv420p"),
        ("a.avi", "rawvideo", "yuyv422"),
        ("a.avi", "huffyuv", "yuv422p"),
        ("a.avi", "utvideo", "yuv420p"),
        ("a.mkv", "ffv1", "yuv420p"),
        ("a.flv", "flv", "yuv420p"),
        ("a.mxf", "mpeg2video", "yuv420p"),
        ("a.ivf", "libvpx", "yuv420p"),
    ],
)
def test_older_and_lossless_codecs_are_read(tmp_path: Path, name: str, codec: str, pixels: str) -> None:
    container = "asf" if name.endswith("wmv") else None
    assert assert_read_whole(write(tmp_path / name, codec=codec, pixels=pixels, container=container), 48) == []


@pytest.mark.parametrize(("container", "codec"), [("m4v", "mpeg4"), ("mpegvideo", "mpeg2video")])
def test_raw_streams_of_mpeg_have_no_clock(tmp_path: Path, container: str, codec: str) -> None:
    container = {"mpegvideo": "mpeg2video"}.get(container, container)  # FFmpeg's name of the same when it writes
    path = write(tmp_path / "a.bin", codec=codec, container=container, b_frames=2)
    assert assert_read_whole(path, 48) == ["no_clock"]


def test_what_recorders_of_dahua_export_is_read(tmp_path: Path) -> None:
    assert assert_read_whole(write_dahua(tmp_path / "a.dav", range(48)), 48) == []


@pytest.mark.parametrize(
    ("content", "what", "hint"),
    [
        (b"<!DOCTYPE html><title>Virus scan warning</title>", "text", "again"),
        (b'\xef\xbb\xbf<?xml version="1.0"?><Code>AccessDenied</Code>', "text", "again"),
        (b'{"error": "not found"}', "text", "again"),
        (b"PK\x03\x04" + bytes(500), "ZIP", "Unpack"),
        (b"\xff\xd8\xff\xe0\x00\x10JFIF" + bytes(500), "single picture", "one video file"),
        (b"#EXTM3U\n#EXTINF:10,\na.ts\n", "play list", "files that it names"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS", "git lfs pull"),
        (bytes(5000), "zeros", "card"),
        (b"\x00\x00\x00\x10moof" + bytes(500), "piece", "first piece"),
    ],
)
def test_what_is_no_recording_is_called_what_it_is(tmp_path: Path, content: bytes, what: str, hint: str) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    with pytest.raises(UnreadableVideo, match=what) as refused:
        probe(path)
    assert hint in refused.value.hint
