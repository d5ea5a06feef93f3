"""Dates and times in names, as phones, screens and recorders of many countries write them."""

from __future__ import annotations

import unicodedata
from datetime import UTC, datetime

import pytest

from wibam_core.video.chapters import in_order
from wibam_core.video.name_times import readings_of, time_in, without_times

NOON = datetime(2024, 5, 1, 12, 0, tzinfo=UTC)


def unix_ns(text: str) -> int:
    return int(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()) * 10**9


@pytest.mark.parametrize(
    "stem",
    [
        "2024-05-01 12-00-00 PM",
        "20240501_120000PM",
        "Screen Recording 2024-05-01 at 12.00.00\u202fp.m",
        "录像_2024年05月01日_12时00分00秒",
        "錄影 2024年5月1日 12點00分",
        "2024년 5월 1일 12시 00분 00초",
        unicodedata.normalize("NFD", "2024년 5월 1일 12시"),
        "cam 01-May-2024 12-00-00",
        "1 May 2024 12.00.00",
        "1714564800",
        "cam_1714564800000",
        "2024-05-01T14:00:00+02:00",
        "20240501T140000+0200",
        "20240501T070000-0500",
        "20240501_173000+0530",
    ],
)
def test_a_time_is_read_in_whatever_way_it_is_written(stem: str) -> None:
    assert readings_of([stem]) == [(int(NOON.timestamp()) * 10**9,)]


@pytest.mark.parametrize(
    ("stem", "hour", "is_utc"),
    [
        ("20240501_120000AM", 0, False),
        ("20240501_090000 am", 9, False),
        ("20240501_090000 PM", 21, False),
        ("20240501T120000+0200", 10, True),
        ("20240501T120000-0200", 14, True),
        ("20240501T120000Z", 12, True),
        ("20240501_120000-0100", 12, False),  # a running number, maybe
        ("20240501_120000_AMBER", 12, False),
        ("2024-05-01 14-30-00 PM", 14, False),
        ("2024-05-01 00-30-00 AM", 0, False),
        ("cam_2024-05-01T08-00-00-08-15-00", 8, False),  # from, to
        ("20240501T081000-0015", 8, False),
        ("20240501T081000-0500-3", 8, False),
    ],
)
def test_halves_of_the_day_and_zones_count(stem: str, hour: int, is_utc: bool) -> None:
    found = time_in(stem)
    assert found is not None
    assert (found[0].replace(minute=0), found[1]) == (datetime(2024, 5, 1, hour, tzinfo=UTC), is_utc)


@pytest.mark.parametrize(
    "stem",
    ["2024年13月01日_10时00分", "31 Feb 2024 10-00-00", "cam_0042", "5000000000", "2024-05-01_3_0930", "1505241000"],
)
def test_what_is_no_time_is_not_read_as_one(stem: str) -> None:
    assert not readings_of([stem])


@pytest.mark.parametrize(
    "stems",
    [
        ("20240501T090000-1000", "20240501T100000-1100"),  # from, to
        ("20240501T095900-0059", "20240501T101000-0100", "20240501T102000-0101"),  # numbers
        ("2024-05-01T09-45-00-10-00-00", "2024-05-01T10-00-00-10-20-00"),
    ],
)
def test_what_ends_a_span_or_counts_is_no_zone(stems: tuple[str, ...]) -> None:
    (times,) = readings_of(stems) or [()]
    hours = [datetime.fromtimestamp(time / 1e9, UTC).strftime("%H%M") for time in times]
    assert hours == [stem.replace("-", "").partition("T")[2][:4] for stem in stems]


def test_ten_digits_are_dates_where_one_can_be() -> None:
    hourly = ["1505241000.mp4", "1505241100.mp4", "1605240000.mp4"]
    assert [named.name for _, named in in_order(hourly[::-1], [None] * 3)] == hourly
    assert all(named.starts_ns is None for _, named in in_order(hourly, [None] * 3))
    assert readings_of(["1505241000", "1505249999"]) is None
    assert readings_of(["1785241000", "1785249999"]) == [(1785241000 * 10**9, 1785249999 * 10**9)]


def test_files_of_an_hour_that_were_copied_together_keep_their_order() -> None:
    names = ["ch01_20240501100000.mp4", "ch01_20240501110000.mp4"]
    for copied in (
        ("18:03:00", "18:00:00"), ("18:00:10", "18:00:00"), ("18:00:00", "18:04:00"), ("18:00:15", "17:59:45"),
    ):  # fmt: skip
        begins = [unix_ns(f"2024-05-01T{text}") for text in copied]
        found = [named for _, named in in_order(names, begins)]
        assert [named.name for named in found] == names
        assert found[1].starts_ns - found[0].starts_ns == 3600 * 10**9


def test_all_of_a_time_is_taken_out_of_a_name() -> None:
    assert without_times("cam2_20240501T140000+0200", "|") == "cam2_|"
    assert without_times("cam2 2024-05-01 12-00-00 PM", "|") == "cam2 |"
    assert without_times("摄像2_2024年05月01日_12时00分00秒", "|") == "摄像2_|"


@pytest.mark.parametrize(
    ("names", "made"),
    [
        (
            ("20241027_025500.mp4", "20241027_020500.mp4", "20241027_021500.mp4"),  # set back at three
            ("2024-10-27T00:55:00", "2024-10-27T01:05:00", "2024-10-27T01:15:00"),
        ),
        (
            ("20240331_015500.mp4", "20240331_030500.mp4", "20240331_031500.mp4"),  # set forward at two
            ("2024-03-31T00:55:00", "2024-03-31T01:05:00", "2024-03-31T01:15:00"),
        ),
    ],
)
def test_summer_time_begins_and_ends_between_files(names: tuple[str, ...], made: tuple[str, ...]) -> None:
    begins = [unix_ns(text) for text in made]
    found = in_order(names[::-1], begins[::-1])
    assert [named.name for _, named in found] == list(names)
    assert [named.starts_ns for _, named in found] == begins


def test_files_that_were_copied_later_are_ordered_by_their_names() -> None:
    """What says when they were made is then the time of the copy, in any order and not an hour beside."""
    names = ["20240501_100000.mp4", "20240501_101000.mp4"]
    begins = [unix_ns("2024-06-01T10:00:30"), unix_ns("2024-06-01T10:00:10")]
    assert [named.name for _, named in in_order(names, begins)] == names


@pytest.mark.parametrize("names", [("cam 10-00-00.mp4", "cam 10-08-00.mp4"), ("01.05.24.mp4", "04.05.24.mp4")])
def test_parts_of_a_time_or_a_date_count_no_missing_files(names: tuple[str, str]) -> None:
    assert all(not named.missing_before for _, named in in_order(names, [None, None]))
