"""Recordings of several files: order, joints without a frame lost or doubled, gaps, missing chapters."""

from pathlib import Path

import numpy as np
import pytest

from tests.foreign_recordings import FPS, copy, number_of, write
from wibam_core.documents.recordings import VideoInfo
from wibam_core.errors import UnreadableVideo
from wibam_core.video.cautions import cautions_of
from wibam_core.video.chapters import in_order
from wibam_core.video.decode import OnePass, decode
from wibam_core.video.probe import measure
from wibam_core.video.recording import Recording

STEP_NS = 1e9 / FPS
MP4_ERROR_NS = 100_000


def read(*paths: Path) -> tuple[VideoInfo, np.ndarray, list[int]]:
    """What is measured, the times in ns, and the numbers seen in the pictures; every time is decoded at that time."""
    recording = Recording.at(*paths)
    info, times_ns = measure(recording)
    decoded = [(time_ns, number_of(image)) for time_ns, image in decode(recording)]
    assert [time_ns for time_ns, _ in decoded] == times_ns.tolist()
    return info, times_ns, [number for _, number in decoded]


def codes(info: VideoInfo) -> list[str]:
    return [caution.code for caution in cautions_of(info)]


def assert_one_timeline(times_ns: np.ndarray, numbers: list[int], count: int) -> None:
    """Frame by frame: none is lost, none doubled, and each has the time that its number says."""
    assert numbers == [*range(count)]
    assert np.abs(times_ns - times_ns[0] - np.arange(count) * STEP_NS).max() < MP4_ERROR_NS


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("GH010042.MP4", "GH020042.MP4", "GH030042.MP4"), []),
        (("GX010007.mp4", "GX020007.mp4", "GX030007.mp4"), []),
        (("GOPR0042.MP4", "GP010042.MP4", "GP020042.MP4"), []),
        (("DJI_0007.MP4", "DJI_0008.MP4", "DJI_0009.MP4"), ["gap_unknown"]),
        (("north_9.mp4", "north_10.mp4", "north_11.mp4"), ["gap_unknown"]),
        (("north.mp4", "north (1).mp4", "north (2).mp4"), ["gap_unknown"]),
    ],
)
def test_chapters_are_joined_in_their_order(tmp_path: Path, names: tuple[str, ...], said: list[str]) -> None:
    paths = [
        write(tmp_path / name, range(20 * part, 20 * part + 20), b_frames=2, key_every=10)
        for part, name in enumerate(names)
    ]
    info, times_ns, numbers = read(paths[2], paths[0], paths[1])
    assert_one_timeline(times_ns, numbers, 60)
    assert [segment.file for segment in info.segments] == list(names)
    assert codes(info) == said


def test_stamps_that_go_on_join_files_cut_between_key_frames(tmp_path: Path) -> None:
    """One decoder reads through: the frames up to the next key frame are not lost."""
    whole = write(tmp_path / "whole.ts", range(60), b_frames=2, key_every=24)
    paths = [
        copy(whole, tmp_path / f"cam_{part}.ts", keep=lambda number, _, part=part: number // 20 == part)  # type: ignore[misc]
        for part in range(3)
    ]
    info, times_ns, numbers = read(*paths)
    assert_one_timeline(times_ns, numbers, 60)
    assert info.unused_frames == info.doubled_frames == 0
    assert [segment.placed_by for segment in info.segments] == ["stamps", "stamps", "stamps"]
    assert codes(info) == []


def test_frames_that_two_files_hold_are_used_once(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.ts", range(72), key_every=12)
    first = copy(whole, tmp_path / "a_1.ts", keep=lambda number, _: number < 40)
    second = copy(whole, tmp_path / "a_2.ts", keep=lambda number, _: number >= 36)
    info, times_ns, numbers = read(first, second)
    assert_one_timeline(times_ns, numbers, 72)
    assert info.doubled_frames == 4


def with_timecode(path: Path, numbers: range, timecode: str) -> Path:
    return write(path, numbers, key_every=12, metadata={"timecode": timecode})


def test_timecodes_keep_the_gap_of_a_missing_chapter_to_the_frame(tmp_path: Path) -> None:
    first = with_timecode(tmp_path / "GH010042.MP4", range(24), "10:00:00:00")
    third = with_timecode(tmp_path / "GH030042.MP4", range(48, 72), "10:00:02:00")
    info, times_ns, numbers = read(third, first)
    assert numbers == [*range(24), *range(48, 72)]
    assert np.abs(times_ns - np.array(numbers) * STEP_NS).max() < MP4_ERROR_NS
    assert info.missing_files == ["GH020042.MP4"]
    assert info.segments[1].placed_by == "timecode"
    assert codes(info) == ["chapter_missing", "recording_gap"]


def test_timecodes_over_midnight(tmp_path: Path) -> None:
    first = with_timecode(tmp_path / "a1.mp4", range(24), "23:59:59:00")
    second = with_timecode(tmp_path / "a2.mp4", range(24, 48), "00:00:00:00")
    info, times_ns, numbers = read(first, second)
    assert_one_timeline(times_ns, numbers, 48)
    assert codes(info) == []


def test_a_missing_first_chapter_is_named(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"GX{chapter:02d}0007.MP4", range(chapter, chapter + 20)) for chapter in (2, 3)]
    info, _, _ = read(*paths)
    assert info.missing_files == ["GX010007.MP4"]
    assert "GX010007.MP4" in cautions_of(info)[0].message


def test_creation_times_keep_a_gap_and_are_called_rough(tmp_path: Path) -> None:
    first = write(tmp_path / "part1.mp4", range(48), metadata={"creation_time": "2024-05-01T10:00:00Z"})
    second = write(tmp_path / "part2.mp4", range(48), metadata={"creation_time": "2024-05-01T10:01:00Z"})
    info, times_ns, numbers = read(first, second)
    assert numbers == [*range(48), *range(48)]
    assert times_ns[48] - times_ns[0] == pytest.approx(60e9, abs=MP4_ERROR_NS)
    assert info.segments[1].placed_by == "creation_time"
    assert set(codes(info)) == {"recording_gap", "gap_rough"}


def test_creation_times_that_tell_when_files_were_finished(tmp_path: Path) -> None:
    """3 s and 1 s long, closed one after the other: no gap."""
    first = write(tmp_path / "part1.mp4", range(72), metadata={"creation_time": "2024-05-01T10:00:03.000Z"})
    second = write(tmp_path / "part2.mp4", range(24), metadata={"creation_time": "2024-05-01T10:00:04.000Z"})
    _, times_ns, _ = read(first, second)
    assert times_ns[72] - times_ns[0] == pytest.approx(3e9, abs=MP4_ERROR_NS)


def test_times_in_the_names_of_a_recorders_files(tmp_path: Path) -> None:
    paths = [
        write(tmp_path / f"ch02_main_{time}.mp4", range(20 * part, 20 * part + 24), key_every=12)
        for part, time in enumerate(("20240501100000", "20240501100030"))
    ]
    info, times_ns, _ = read(*reversed(paths))
    assert times_ns[24] - times_ns[0] == pytest.approx(30e9, abs=MP4_ERROR_NS)
    assert info.segments[1].placed_by == "name"


def test_a_missing_number_is_named_where_time_is_missing_too(tmp_path: Path) -> None:
    def part(number: int, second: int) -> Path:
        time = f"2024-05-01T10:00:{second:02d}Z"
        return write(tmp_path / f"DJI_{number:04d}.MP4", range(48), metadata={"creation_time": time})

    info, _, _ = read(part(7, 0), part(9, 4), part(11, 6))  # no. 10 was a photograph
    assert info.missing_files == ["DJI_0008.MP4"]


def test_files_in_no_order_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableVideo, match=r"order of .*left\.mp4") as refused:
        read(write(tmp_path / "left.mp4"), write(tmp_path / "right.mp4", range(1, 40)))
    assert "Number the names" in refused.value.hint


def test_files_without_a_telling_name_are_ordered_by_their_dates() -> None:
    assert [index for index, _ in in_order(["morning.mp4", "noon.mp4"], [20, 10])] == [1, 0]


def test_frames_are_found_over_a_joint(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"GH0{part + 1}0042.MP4", range(24 * part, 24 * part + 24)) for part in range(2)]
    one_pass = OnePass(Recording.at(*paths))
    for number in (0, 23, 24, 47):
        frame = one_pass.nearest(round(number * STEP_NS), 1_000_000)
        assert frame is not None and number_of(frame.image_bgr) == number


def test_a_copy_of_a_file_is_refused_by_name(tmp_path: Path) -> None:
    first = write(tmp_path / "north_1.mp4", range(24))
    other = write(tmp_path / "north_2.mp4", range(24, 48))
    copied = tmp_path / "north_3.mp4"
    copied.write_bytes(first.read_bytes())
    with pytest.raises(UnreadableVideo, match=r"north_3\.mp4 is a copy of north_1\.mp4"):
        measure(Recording.at(first, other, copied))


def test_channels_of_a_recorder_are_no_parts_of_one_recording() -> None:
    names = ["ch01_20240501100000.mp4", "ch02_20240501101000.mp4"]
    with pytest.raises(UnreadableVideo, match="different channels"):
        in_order(names, [None, None])
    of_one = ["ch01_20240501100000_20240501101000.mp4", "ch01_20240501101000_20240501102000.mp4"]
    assert [index for index, _ in in_order(of_one[::-1], [None, None])] == [1, 0]


@pytest.mark.parametrize(("first", "second"), [(range(30), range(30, 31)), (range(1), range(1, 31))])
def test_a_chapter_of_a_single_frame_is_part_of_the_recording(tmp_path: Path, first: range, second: range) -> None:
    paths = [write(tmp_path / "GX010042.MP4", first), write(tmp_path / "GX020042.MP4", second)]
    info, times_ns, numbers = read(*paths)
    assert_one_timeline(times_ns, numbers, 31)
    assert codes(info) == []


def test_files_of_single_frames_alone_are_no_recording(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"GX0{number}0042.MP4", range(1)) for number in (1, 2)]
    paths[1].write_bytes(paths[1].read_bytes() + bytes(8))  # no copy
    with pytest.raises(UnreadableVideo, match="single frame"):
        read(*paths)


def test_what_was_assumed_of_a_missing_chapter_is_said(tmp_path: Path) -> None:
    info, _, _ = read(write(tmp_path / "GX010042.MP4", range(30)), write(tmp_path / "GX030042.MP4", range(60, 70)))
    said = {caution.code: caution.message for caution in cautions_of(info)}
    assert "GX020042.MP4 should lie between" in said["chapter_missing"]
    assert "as long as the file before" in said["gap_unknown"]
    assert info.segments[1].first_ns == pytest.approx(60 * STEP_NS, abs=MP4_ERROR_NS)


@pytest.mark.parametrize(
    "names",
    [
        ("10.0.0.8_01_20240501100000123_1.mp4", "10.0.0.8_01_20240501101000456_2.mp4"),
        ("31-05-2024 10-00-00.mp4", "01-06-2024 10-10-00.mp4"),
        ("05.31.2024_10.00.00.mp4", "05.31.2024_10.10.00.mp4"),
        ("2024_0501_100000_001F.MP4", "2024_0501_100300_002F.MP4"),
        ("20240501_100000_NF.mp4", "20240501_100100_EF.mp4"),
        ("VID_20240501_100000_00_001.mp4", "VID_20240501_100000_00_002.mp4"),
        ("2024-05-01_10-00-00Z.mp4", "2024-05-01_10-05-00R.mp4"),
        ("2024-05-01T100000Z.mp4", "2024-05-01T100500T.mp4"),
    ],
)
def test_names_of_recorders_and_dashcams_tell_the_order(names: tuple[str, str]) -> None:
    assert [named.name for _, named in in_order(names[::-1], [None, None])] == list(names)
    assert all(not named.missing_before for _, named in in_order(names, [None, None]))


def test_letters_behind_different_numbers_are_no_views() -> None:
    assert [index for index, _ in in_order(["a_02t.mp4", "a_01f.mp4"], [20, 10])] == [1, 0]


@pytest.mark.parametrize(
    "names",
    [
        ("01_20240501100000123.mp4", "01_20240501101000456.mp4"),
        ("2024-05-01_10-00-00.123Z.mkv", "2024-05-01_10-10-00.456Z.mkv"),
        ("20240501T100000,123.mp4", "20240501T101000,456.mp4"),
    ],
)
def test_a_name_tells_when_a_file_begins_to_a_millisecond(names: tuple[str, str]) -> None:
    [(_, first), (_, second)] = in_order(names, [None, None])
    assert first.starts_ns is not None and second.starts_ns is not None
    assert second.starts_ns - first.starts_ns == 600_333_000_000


@pytest.mark.parametrize(
    "names",
    [
        ("2024-05-01_10-00-00-front.mp4", "2024-05-01_10-01-00-back.mp4"),
        ("2024_0501_100000_001F.MP4", "2024_0501_100001_001R.MP4"),
        ("20240501_100000_NF.mp4", "20240501_100000_NR.mp4"),
        ("2024_0501_100000_001F.MP4", "2024_0501_100001_002R.MP4"),
        ("a_01f.mp4", "a_01r.mp4"),
        ("DJI_20240501100000_0001_W.MP4", "DJI_20240501100001_0001_T.MP4"),
        ("VID_20240501_100000_00_001.insv", "VID_20240501_100000_10_001.insv"),
    ],
)
def test_views_that_were_recorded_together_are_not_joined(names: tuple[str, str]) -> None:
    with pytest.raises(UnreadableVideo, match="different views") as refused:
        in_order(names, [None, None])
    assert "camera of its own" in refused.value.hint


#: A day in ns, and the time of a file's being made that comes without one.
DAY_NS = 86_400_000_000_000
UNMADE = (None, None)


@pytest.mark.parametrize(
    ("first", "second", "made_ns", "apart_s"),
    [
        ("02-12-2024 23-59-58", "02-13-2024 00-00-00", UNMADE, 2),  # 13 is no month, so that 12 is a day
        ("01-31-2024 23-59-58", "02-01-2024 00-00-00", UNMADE, 2),
        ("31-01-2024 23-59-58", "01-02-2024 00-00-00", UNMADE, 2),
        ("12-02-2024 23-59-58", "13-02-2024 00-00-00", UNMADE, 2),
        ("02-03-2024 23-59-58", "02-04-2024 00-00-00", UNMADE, 2),  # follow one another if the month is first
        ("03-02-2024 23-59-58", "04-02-2024 00-00-00", UNMADE, 2),  # and if the day is
        ("02-03-2024 10-00-00", "02-03-2024 10-10-00", UNMADE, 600),  # either way
        ("01-05-2024 10-00-00", "01-06-2024 10-00-00", (0, DAY_NS), 86_400),
        ("01-05-2024 10-00-00", "01-06-2024 10-00-00", (0, 31 * DAY_NS), 31 * 86_400),
        ("01-02-2024 10-00-00", "02-01-2024 10-00-00", (7, 30 * DAY_NS), 30 * 86_400),
        ("02-01-2024 10-00-00", "01-02-2024 10-00-00", (7, 30 * DAY_NS), 30 * 86_400),
        ("2024-02-03 23-59-58", "02-04-2024 00-00-00", UNMADE, 2),
    ],
)
def test_one_rule_of_day_and_month_holds_for_all_names(
    first: str, second: str, made_ns: tuple[int | None, int | None], apart_s: int
) -> None:
    for names, made in (((first, second), made_ns), ((second, first), made_ns[::-1])):
        ordered = [named for _, named in in_order([f"cam {name}.mp4" for name in names], made)]
        assert [named.name for named in ordered] == [f"cam {first}.mp4", f"cam {second}.mp4"]
        starts = [named.starts_ns for named in ordered]
        assert starts[0] is not None and starts[1] is not None
        assert starts[1] - starts[0] == apart_s * 1_000_000_000


@pytest.mark.parametrize(
    "names",
    [("31-05-2024 10-00-00.mp4", "05-30-2024 10-00-00.mp4"), ("01-02-2024 10-00-00.mp4", "02-01-2024 10-00-00.mp4")],
)
def test_dates_of_an_unclear_order_are_refused_where_no_file_says_when_it_was_made(names: tuple[str, str]) -> None:
    with pytest.raises(UnreadableVideo, match="day or the month") as refused:
        in_order(names, [None, None])
    assert "year in front" in refused.value.hint
    assert [index for index, _ in in_order(names, [20, 10])] == [1, 0]


def test_how_long_a_camera_was_off_is_not_told_by_dates_that_may_be_read_in_two_ways(tmp_path: Path) -> None:
    """A day or a month: the order is certain, the time between is not."""
    info, times_ns, numbers = read(
        write(tmp_path / "01-06-2024 10-00-00.mp4", range(24, 48)),
        write(tmp_path / "01-05-2024 10-00-00.mp4", range(24)),
    )
    assert_one_timeline(times_ns, numbers, 48)
    assert codes(info) == ["gap_unknown"]


@pytest.mark.parametrize(
    ("rates", "said"), [((24, 240), [(24, 240)]), ((240, 24), [(240, 24)]), ((24, 24), []), ((24, 30), [])]
)
def test_chapters_of_another_frame_rate_are_named(
    tmp_path: Path, rates: tuple[int, int], said: list[tuple[int, int]]
) -> None:
    """Whoever switches a camera to slow motion between two chapters gets another rate, and often another section."""
    paths = [
        write(tmp_path / f"GX0{part + 1}0042.MP4", range(30 * part, 30 * part + 30), rate=rate)
        for part, rate in enumerate(rates)
    ]
    info, times_ns, _ = read(*paths)
    assert [(round(change.before_fps), round(change.fps)) for change in info.rate_changes] == said
    assert codes(info) == ["rate_changes"] * len(said)
    assert np.diff(times_ns[:30]).mean() == pytest.approx(1e9 / rates[0], rel=1e-3)
    assert np.diff(times_ns[30:]).mean() == pytest.approx(1e9 / rates[1], rel=1e-3)
    for caution in cautions_of(info):
        assert (
            f"from {30 / rates[0]:.1f} s on it has {rates[1]} frames a second, and {rates[0]} before" in caution.message
        )
