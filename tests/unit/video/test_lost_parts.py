"""What is lost or passed over in a file: frames on the way, files joined byte by byte, tracks that go on elsewhere."""

from pathlib import Path

import av
import pytest

from tests.foreign_recordings import copy, number_of, write
from wibam_core.documents.recordings import VideoInfo
from wibam_core.video.cautions import cautions_of
from wibam_core.video.decode import decode
from wibam_core.video.probe import probe


def codes(info: VideoInfo) -> list[str]:
    return [caution.code for caution in cautions_of(info)]


@pytest.mark.parametrize("name", ["a.ts", "a.mp4", "a.mkv"])
def test_frames_after_lost_ones_are_said_to_be_smeared(tmp_path: Path, name: str) -> None:
    """Of 72 frames with a whole one every 24, ten are lost: those after them show what was before, up to the next."""
    whole = write(tmp_path / f"whole{Path(name).suffix}", range(72))
    path = copy(whole, tmp_path / name, keep=lambda number, packet: not 30 <= number < 40)
    truth = [*range(30), *range(40, 72)]
    smeared = sum(
        number_of(image) != number for number, (_, image) in zip(truth, decode(path), strict=True) if number < 48
    )
    info = probe(path)
    assert smeared == 8  # the decoder says nothing of it, and the pictures show it
    assert info.smeared_frames == 8
    [caution] = cautions_of(info)
    assert caution.code == "frames_smeared" and "8 frames, 13% of the recording" in caution.message


@pytest.mark.parametrize("b_frames", [0, 2])
def test_a_whole_recording_has_no_smeared_frames(tmp_path: Path, b_frames: int) -> None:
    path = write(tmp_path / "a.mp4", range(72), b_frames=b_frames)
    assert probe(path).smeared_frames == 0
    cut = copy(path, tmp_path / "b.mp4", keep=lambda number, packet: number >= 24)
    assert probe(cut).smeared_frames == 0


def test_lost_packets_of_a_transport_stream_smear_other_codecs_too(tmp_path: Path) -> None:
    path = write(tmp_path / "a.ts", range(72), codec="mpeg2video")
    data = path.read_bytes()
    packets = [data[at : at + 188] for at in range(0, len(data), 188)]
    path.write_bytes(b"".join(packet for number, packet in enumerate(packets) if number != len(packets) // 2))
    assert codes(probe(path)) == ["frames_smeared"]


@pytest.mark.parametrize(
    ("name", "codec"), [("a.mp4", "libx264"), ("a.mov", "libx264"), ("a.flv", "libx264"), ("a.wmv", "wmv2")]
)
def test_the_rest_of_files_joined_byte_by_byte_is_said_to_be_unread(tmp_path: Path, name: str, codec: str) -> None:
    container = "asf" if name.endswith("wmv") else None
    path = write(tmp_path / name, range(30), codec=codec, container=container)
    assert codes(probe(path)) == []
    second = write(tmp_path / f"second-{name}", range(30, 60), codec=codec, container=container)
    path.write_bytes(path.read_bytes() + second.read_bytes())
    info = probe(path)
    assert info.frames == 30
    assert 0.3 < info.unread_share < 0.7
    assert codes(info) == ["part_unread"]


@pytest.mark.parametrize("codec", ["libx264", "mpeg4"])
def test_the_second_of_joined_avi_files_is_a_segment_of_its_own(tmp_path: Path, codec: str) -> None:
    path = write(tmp_path / "a.avi", range(30), codec=codec, b_frames=2)
    second = write(tmp_path / "b.avi", range(30, 60), codec=codec, b_frames=2)
    path.write_bytes(path.read_bytes() + second.read_bytes())
    info = probe(path)
    assert [(segment.frames, segment.placed_by) for segment in info.segments] == [(30, "stamps"), (30, "assumed")]
    assert [number_of(image) for _, image in decode(path)] == [*range(60)]
    assert codes(info) == ["gap_unknown"]


def transport_stream(path: Path, numbers: range, *, track: int, shift_s: float) -> Path:
    """A transport stream whose video has this packet identifier."""
    return copy(write(path.with_suffix(".mkv"), numbers), path, shift_s=shift_s, mpegts_start_pid=str(track))


def test_a_track_that_goes_on_under_another_number_is_said_to_be_unread(tmp_path: Path) -> None:
    """A recorder that was restarted, or whose stream was, may number its tracks anew."""
    first = transport_stream(tmp_path / "a.ts", range(30), track=256, shift_s=0)
    second = transport_stream(tmp_path / "b.ts", range(30, 60), track=512, shift_s=1.25)
    path = tmp_path / "joined.ts"
    path.write_bytes(first.read_bytes() + second.read_bytes())
    info = probe(path)
    assert info.frames == 30
    assert "part_unread" in codes(info)


def test_a_codec_that_changes_midway_leaves_no_frames_that_nothing_decodes(tmp_path: Path) -> None:
    first = copy(write(tmp_path / "a.mkv", range(30)), tmp_path / "a.ts")
    with av.logging.Capture():
        second = write(tmp_path / "b.mkv", range(30, 60), codec="libx265", options={"x265-params": "log-level=none"})
    copy(second, tmp_path / "b.ts", shift_s=1.25)
    path = tmp_path / "joined.ts"
    path.write_bytes(first.read_bytes() + (tmp_path / "b.ts").read_bytes())
    info = probe(path)
    assert len(list(decode(path))) == info.frames
    assert codes(info) == ["frames_unused"]


def test_frames_that_an_avi_repeats_are_not_missing(tmp_path: Path) -> None:
    """Capture programs write nothing for a frame that is as the one before; the file still counts it."""
    whole = write(tmp_path / "a.avi", range(48), codec="mjpeg", pixels="yuvj420p")
    path = copy(whole, tmp_path / "b.avi", keep=lambda number, packet: number % 7 != 3)
    info = probe(path)
    assert (info.frames, info.duration_s) == (41, pytest.approx(2.0))
    assert codes(info) == []
