"""Clocks as recordings bring them: stray stamps, restarts, decode times, edit lists, cuts between key frames."""

import struct
from pathlib import Path

import numpy as np
import pytest

from tests.foreign_recordings import FPS, copy, edit_mp4, number_of, restamp_ts, write
from wibam_core.documents.recordings import VideoInfo
from wibam_core.video.cautions import cautions_of
from wibam_core.video.decode import decode
from wibam_core.video.edits import shown_stretches
from wibam_core.video.probe import measure
from wibam_core.video.recording import Recording

STEP_NS = 1e9 / FPS


def read(*paths: Path) -> tuple[VideoInfo, np.ndarray, list[int]]:
    """What is measured, the times in ns, and the numbers seen in the pictures; every time is decoded at that time."""
    recording = Recording.at(*paths)
    info, times_ns = measure(recording)
    decoded = [(time_ns, number_of(image)) for time_ns, image in decode(recording)]
    assert [time_ns for time_ns, _ in decoded] == times_ns.tolist()
    return info, times_ns, [number for _, number in decoded]


def codes(info: VideoInfo) -> list[str]:
    return [caution.code for caution in cautions_of(info)]


def assert_true_times(times_ns: np.ndarray, numbers: list[int]) -> None:
    """Each picture has the time that its number says, against the first."""
    want = (np.array(numbers) - numbers[0]) * STEP_NS
    assert np.abs(times_ns - times_ns[0] - want).max() < 20_000  # stamps are rounded to 1/90000 s


@pytest.mark.parametrize(
    ("jump_s", "b_frames"), [(30, 0), (600, 0), (37_600, 0), (-9_800, 0), (2, 0), (-0.5, 0), (30, 2), (-9_800, 2)]
)
def test_a_stray_stamp_costs_one_frame_and_is_said(tmp_path: Path, jump_s: float, b_frames: int) -> None:
    path = write(tmp_path / "a.ts", range(60), b_frames=b_frames)
    restamp_ts(path, 30, jump_s)
    info, times_ns, numbers = read(path)
    assert len(numbers) == 59
    assert_true_times(times_ns, numbers)
    assert info.duration_s == pytest.approx(60 / FPS, abs=0.001)
    assert (info.unused_frames, info.stray_frames, info.segments) == (1, 1, [])
    [caution] = cautions_of(info)
    assert caution.code == "stray_stamps" and caution.message.startswith("1 frame has a time stamp far from")


def test_a_clock_that_starts_again_is_a_segment_behind_the_first(tmp_path: Path) -> None:
    part = write(tmp_path / "a.ts").read_bytes()
    path = tmp_path / "joined.ts"
    path.write_bytes(part + part)
    info, times_ns, numbers = read(path)
    assert numbers == [*range(48), *range(48)]
    assert info.duration_s == pytest.approx(4.0, abs=0.001)
    assert np.abs(np.diff(times_ns) - STEP_NS).max() < 20_000
    assert [(s.frames, s.placed_by) for s in info.segments] == [(48, "stamps"), (48, "assumed")]
    assert info.segments[1].first_ns == times_ns[48]
    assert codes(info) == ["gap_unknown"]


def test_a_time_without_frames_is_kept_and_begins_a_segment(tmp_path: Path) -> None:
    first = write(tmp_path / "a.ts")
    later = copy(first, tmp_path / "b.ts", shift_s=32.0)
    path = tmp_path / "joined.ts"
    path.write_bytes(first.read_bytes() + later.read_bytes())
    info, times_ns, numbers = read(path)
    assert numbers == [*range(48), *range(48)]
    assert times_ns[48] - times_ns[0] == pytest.approx(32e9, abs=20_000)
    assert [s.placed_by for s in info.segments] == ["stamps", "stamps"]
    assert codes(info) == ["recording_gap"]


def test_a_counter_of_33_bits_that_wraps_goes_on(tmp_path: Path) -> None:
    wrap_s = 2**33 / 90_000
    path = copy(write(tmp_path / "a.ts"), tmp_path / "b.ts", shift_s=wrap_s - 1)
    info, times_ns, numbers = read(path)
    assert numbers == [*range(48)]
    assert_true_times(times_ns, numbers)
    assert codes(info) == []


@pytest.mark.parametrize("codec", ["libx264", "mpeg4"])
def test_avi_with_b_frames_is_read_in_the_order_shown(tmp_path: Path, codec: str) -> None:
    info, times_ns, numbers = read(write(tmp_path / "a.avi", codec=codec, b_frames=2))
    assert numbers == [*range(48)]
    assert_true_times(times_ns, numbers)
    assert codes(info) == []


def test_damage_in_avi_moves_no_later_frame(tmp_path: Path) -> None:
    """Where decoding order is all there is, a frame that does not decode still takes its place."""
    path = write(tmp_path / "a.avi", range(72), codec="mpeg4", b_frames=2, key_every=12)
    data = bytearray(path.read_bytes())
    vops = [at for at in range(len(data) - 4) if data[at : at + 4] == b"\0\0\1\xb6"]
    data[vops[20] : vops[20] + 4] = b"\0\0\1\xb2"  # user data instead of a picture
    path.write_bytes(data)
    times = {number_of(image): time_ns for time_ns, image in decode(path)}
    assert len(times) < 72
    assert times[71] - times[0] == pytest.approx(71 * STEP_NS, abs=20_000)


def test_a_raw_stream_is_read_in_order_and_its_rate_doubted(tmp_path: Path) -> None:
    info, times_ns, numbers = read(write(tmp_path / "a.h264", container="h264", b_frames=2))
    assert numbers == [*range(48)]
    assert_true_times(times_ns, numbers)
    assert codes(info) == ["no_clock"]


def test_a_trimmed_mp4_is_not_cut_off_and_a_long_lead_in_that_it_hides_is_said(tmp_path: Path) -> None:
    whole = write(tmp_path / "a.mp4", range(72), b_frames=2, key_every=48)
    info, _, numbers = read(copy(whole, tmp_path / "b.mp4", shift_s=-1.0))
    assert numbers == [*range(24, 72)]
    assert (info.hidden_frames, info.missing_frames) == (24, 0)
    [caution] = cautions_of(info)
    assert caution.code == "frames_hidden" and "24 frames, 33% of the file" in caution.message
    assert codes(info.model_copy(update={"hidden_frames": 1})) == ["frames_hidden"]  # of 49
    assert codes(info.model_copy(update={"hidden_frames": 1, "frames": 60})) == []


@pytest.mark.parametrize(
    ("stretches", "shown", "said"),
    [
        ([(2.0, 1.0)], [*range(24, 72)], ["frames_hidden"]),
        ([(1.0, 0.0)], [*range(24)], ["frames_hidden"]),
        ([(1.0, 0.0), (1.0, 2.0)], [*range(24), *range(48, 72)], ["frames_hidden", "edited"]),
        ([(3.0, 0.0)], [*range(72)], []),
    ],
    ids=["from", "until", "skip", "all"],
)
def test_what_an_edit_list_hides_is_counted_and_a_skip_is_said(tmp_path: Path, stretches, shown, said) -> None:  # type: ignore[no-untyped-def]
    path = write(tmp_path / "a.mp4", range(72))
    edit_mp4(path, *stretches)
    info, _, numbers = read(path)
    assert numbers == shown
    assert info.hidden_frames == 72 - len(shown)
    assert codes(info) == said


def box(kind: bytes, *inside: bytes) -> bytes:
    return struct.pack(">I4s", 8 + sum(map(len, inside)), kind) + b"".join(inside)


@pytest.mark.parametrize("head", [b"", b"\0\0\0\0", b"\0\0\0\0\0\0"])
def test_an_edit_list_that_is_cut_off_shows_nothing(tmp_path: Path, head: bytes) -> None:
    """The other track has two entries, and counts whatever the first is; a box may follow or not."""
    video = box(b"mdia", box(b"hdlr", bytes(8), b"vide"))
    entries = struct.pack(">IiI", 1, 0, 1 << 16) + struct.pack(">IiI", 1, 5, 1 << 16)
    whole = box(b"trak", video, box(b"edts", box(b"elst", struct.pack(">II", 0, 2), entries)))
    cut = box(b"trak", video, box(b"edts", box(b"elst", head)))
    path = tmp_path / "a.mp4"
    for tracks, stretches in ((cut, 1), (whole + cut, 2), (cut + whole, 2)):
        path.write_bytes(box(b"moov", tracks))
        assert shown_stretches(path) == stretches


def test_a_recording_that_begins_between_key_frames_is_normal(tmp_path: Path) -> None:
    whole = write(tmp_path / "a.ts", range(72))
    info, times_ns, numbers = read(copy(whole, tmp_path / "b.ts", keep=lambda number, _: number >= 23))
    assert numbers == [*range(24, 72)]
    assert_true_times(times_ns, numbers)
    assert (info.lead_in_frames, codes(info)) == (1, ["lead_in"])  # 1 of 49 is said, as all beyond 2 %
    assert codes(info.model_copy(update={"frames": 60})) == []


def test_a_matroska_file_that_was_cut_off_is_said_by_how_much(tmp_path: Path) -> None:
    whole = write(tmp_path / "a.mkv", range(120), key_every=12).read_bytes()
    (tmp_path / "b.mkv").write_bytes(whole[: len(whole) * 8 // 10])
    info, _, numbers = read(tmp_path / "b.mkv")
    assert numbers == [*range(len(numbers))] and 36 < len(numbers) < 110
    [caution] = cautions_of(info)
    assert caution.code == "cut_off" and caution.details["missing_s"] == pytest.approx(5 - len(numbers) / FPS, abs=0.05)


def test_slow_motion_is_told_by_what_the_camera_wrote(tmp_path: Path) -> None:
    for taken, expected in (("240.0", ["other_speed"]), ("24.000000", []), ("0", [])):
        metadata = {"com.android.capture.fps": taken}
        info, _, _ = read(write(tmp_path / "a.mkv", metadata=metadata))
        assert codes(info) == expected


def test_negative_first_stamps_are_normal(tmp_path: Path) -> None:
    path = copy(write(tmp_path / "a.mkv"), tmp_path / "b.asf", shift_s=-0.51, avoid_negative_ts="disabled")
    info, times_ns, numbers = read(path)
    assert numbers == [*range(48)]
    assert times_ns[0] == pytest.approx(-0.468e9, abs=2e6)  # ASF adds a frame
    assert codes(info) == []


def test_many_frames_with_one_stamp_are_said(tmp_path: Path) -> None:
    path = write(tmp_path / "a.ts", range(72))
    for frame in range(20, 60, 4):
        restamp_ts(path, frame, -1 / FPS)
    info, times_ns, numbers = read(path)
    assert len(numbers) == 62
    assert_true_times(times_ns, numbers)
    assert info.unused_frames == 10
    assert "frames_unused" in codes(info)


def test_a_variable_rate_is_normal(tmp_path: Path) -> None:
    whole = write(tmp_path / "a.mkv", range(72), key_every=1)
    info, times_ns, numbers = read(copy(whole, tmp_path / "b.mkv", keep=lambda number, _: number % 7 not in (2, 3, 5)))
    assert info.variable_rate
    assert np.abs(times_ns - np.array(numbers) * STEP_NS).max() < 1_000_000  # Matroska counts milliseconds
    assert codes(info) == []
