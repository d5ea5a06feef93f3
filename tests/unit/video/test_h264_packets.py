"""What stands beside pictures in packets of H.264: no frame is lost for it, and what is no picture is counted."""

from pathlib import Path

import av
import pytest

from tests.foreign_recordings import number_of, write
from wibam_core.video.decode import decode
from wibam_core.video.probe import probe

_START = b"\x00\x00\x01"
#: Units by the low five bits of their first byte (ITU-T H.264, table 7-1).
_PPS = 8


def user_data(count: int) -> bytes:
    """A unit of supplemental information (7.3.2.3) that holds so many bytes of the camera's own (D.1.6)."""
    content = bytes(range(16)) + bytes(1 + at % 250 for at in range(count - 16))
    return b"\x06\x05" + b"\xff" * (count // 255) + bytes([count % 255]) + content + b"\x80"


def with_user_data(source: Path, path: Path, count: int) -> Path:
    """The packets of a Matroska file in another, before each picture but the whole ones what the camera tells."""
    unit = user_data(count)
    with av.open(str(source)) as opened, av.open(str(path), "w") as output:
        stream = output.add_stream_from_template(opened.streams.video[0])
        for packet in opened.demux(opened.streams.video[0]):
            if not packet.size:
                continue
            told = b"" if packet.is_keyframe else len(unit).to_bytes(4, "big") + unit
            changed = av.Packet(told + bytes(packet))
            changed.pts, changed.dts, changed.time_base = packet.pts, packet.pts, packet.time_base
            changed.is_keyframe, changed.stream = packet.is_keyframe, stream
            output.mux(changed)
    return path


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.ts", "a.h264"])
def test_much_that_is_told_before_a_picture_hides_none(tmp_path: Path, name: str) -> None:
    path = with_user_data(write(tmp_path / "whole.mkv"), tmp_path / name, 20_000)
    info = probe(path)
    assert (info.frames, info.unused_frames, info.smeared_frames) == (48, 0, 0)
    assert [number_of(image) for _, image in decode(path)] == [*range(48)]


def test_empty_units_are_passed_over(tmp_path: Path) -> None:
    path = write(tmp_path / "a.h264")
    before, *units = path.read_bytes().split(_START)
    path.write_bytes(before + b"".join((_START if unit[0] & 31 == _PPS else b"") + _START + unit for unit in units))
    assert probe(path).frames == 48
    assert [number_of(image) for _, image in decode(path)] == [*range(48)]


def test_a_raw_stream_that_ends_before_its_last_picture_says_so(tmp_path: Path) -> None:
    """What is told before a picture is there, and the picture is not."""
    path = write(tmp_path / "a.h264")
    data = path.read_bytes()
    path.write_bytes(data + _START + user_data(200))
    info = probe(path)
    assert (info.frames, info.unused_frames) == (48, 1)
