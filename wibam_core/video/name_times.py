"""Dates and times in files' names, as cameras and recorders write them.

A date with the year in front is read by itself. One with the day or the month in front is not: 02-12-2024 is in
February or in December. All files of a camera are named by one rule, so that the rule is sought under which all names
together make sense.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from itertools import pairwise

from wibam_core.text import nfc

#: One digit is an hour where one and the same sign sets hour, minute and second apart: else it may count something.
_HOUR = r"(\d{2}|\d(?=-\d\d-\d\d|_\d\d_\d\d|\.\d\d\.\d\d|:\d\d:\d\d|h\d\dm?\d\d))"
#: Behind a minus only what is a zone and nothing else goes on: a time may also end a span, and a number count files.
_OFFSET = (
    r"(Z(?![A-Za-z])|\+(?:0\d|1[0-4])[-_.:]?(?:00|15|30|45)(?!\d)"
    r"|-(?:(?:0[1-9]|1[0-2]):?00|0[39]:?30)(?![-_.:]?\d))?"
)
_TIME_OF_DAY = (
    rf"{_HOUR}[-_.:h]?(\d{{2}})[-_.:m]?(\d{{2}})(?:[.,]?(\d{{3}}))?(?!\d)(?:[\s_-]?([AP])\.?M(?![A-Za-z]))?{_OFFSET}"
)
_BETWEEN = r"([-_.T ]{0,3}| at )"
_YEAR_FIRST = re.compile(
    rf"(?<!\d)((?:19|20)\d{{2}})[-_.]?(\d{{2}})[-_.]?(\d{{2}}){_BETWEEN}{_TIME_OF_DAY}", re.IGNORECASE
)
_YEAR_LAST = re.compile(
    rf"(?<!\d)(\d{{2}})[-_.](\d{{2}})[-_.]((?:19|20)\d{{2}})([-_.T ]{{1,3}}| at ){_TIME_OF_DAY}", re.IGNORECASE
)
#: As in China, Japan and Korea: a year, a month and a day, each with its sign behind it.
_SIGNS = re.compile(
    r"(?<!\d)(\d{4})[年년]\s?(\d{1,2})[月월]\s?(\d{1,2})[日일][\s_-]{0,2}"
    r"(\d{1,2})[時时点點시:](?:\s?(\d{1,2})[分분:](?:\s?(\d{1,2})[秒초]?)?)?"
)
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_MONTH_NAMED = re.compile(
    rf"(?<!\d)(\d{{1,2}})[-_. ]({'|'.join(_MONTHS)})[a-z]*[-_. ]((?:19|20)\d{{2}}){_BETWEEN}{_TIME_OF_DAY}",
    re.IGNORECASE,
)
#: Unix time in seconds or milliseconds, from 2010 to 2033, where no name is a date that looks alike.
_UNIX = re.compile(r"(?<!\d)(1[3-9]\d{8}|12[6-9]\d{7})(\d{3})?(?!\d)")
_PACKED_DATES = ("%y%m%d%H%M", "%d%m%y%H%M", "%d%m%Y%H")
_YEARS = range(1990, 2100)
_ALL = (_YEAR_FIRST, _YEAR_LAST, _SIGNS, _MONTH_NAMED)

_DAY_NS = 86_400_000_000_000


def without_times(text: str, instead: str = "") -> str:
    """The text with something else in the place of each date and time, and of what is said of its zone."""
    for pattern in _ALL:
        text = pattern.sub(instead, text)
    return text


def time_in(stem: str) -> tuple[datetime, bool] | None:
    """A date and time with the year in front, and whether a Z or an offset says that it is UTC; None without one.

    With an offset it is UTC; with nothing behind it, it is taken as if it were.

    Args:
        stem: a file's name without its extension, which may look like thousandths (``.264``).
    """
    match = _YEAR_FIRST.search(stem)
    return _time(*match.groups()) if match else None


def readings_of(stems: Sequence[str]) -> list[tuple[int, ...]] | None:
    """When each file begins by its name, by each rule under which all names are dates: day first, then month first.

    Args:
        stems: names without their extensions.

    Returns:
        Times as if they were UTC, ns, of all files, by rule: two where both rules make dates that lie otherwise apart,
        none where each name is a date, but not all by one rule; None where some name is no date.
    """
    zoned, unix = _have_zones(stems), not any(map(_is_packed_date, stems))
    by_rule = [
        [_start_ns(stem, month_first=month_first, zoned=zoned, unix=unix) for stem in stems]
        for month_first in (False, True)
    ]
    if any(day is None and month is None for day, month in zip(*by_rule, strict=True)):
        return None
    readings = [tuple(time for time in times if time is not None) for times in by_rule if None not in times]
    if len(readings) == 2 and len({day - month for day, month in zip(*readings, strict=True)}) == 1:
        return readings[:1]
    return readings


def likely(readings: Sequence[tuple[int, ...]], created_ns: Sequence[int | None]) -> tuple[int, ...] | None:
    """The one of the readings that the files themselves, or else their lying together, speaks for; None: neither does.

    By two rules a date lies whole days apart. So no two fit where half a day is allowed, which no time zone and no
    file's length come near; and files that follow one another within a day do so by one rule alone.

    Args:
        readings: times of all files (`readings_of`).
        created_ns: when each file says that it was made, Unix time.
    """
    if len(readings) == 1:
        return readings[0]
    for fits in (
        [times for times in readings if _agree(times, created_ns)],
        [times for times in readings if all(b - a < _DAY_NS for a, b in pairwise(sorted(times)))],
    ):
        if len(fits) == 1:
            return fits[0]
    return None


def _agree(times_ns: Sequence[int], created_ns: Sequence[int | None]) -> bool:
    """Whether two clocks tell the same but for a constant: that of a time zone, or of a clock set wrongly."""
    apart = [time - made for time, made in zip(times_ns, created_ns, strict=True) if made is not None]
    return len(apart) > 1 and max(apart) - min(apart) < _DAY_NS // 2


def _have_zones(stems: Sequence[str]) -> bool:
    """Whether each name has its zone: a minus with four digits is none where they differ, as the ends of spans do."""
    zones = [match.groups()[-1] for stem in stems for pattern in _ALL if (match := pattern.search(stem))]
    if len(zones) < len(stems) or None in zones:
        return False
    return len(set(zones)) == 1 or not any(zone[0] == "-" and ":" not in zone for zone in zones)


def _is_packed_date(stem: str) -> bool:
    """Whether ten digits that may be Unix time are also a date and an hour: 1505241000 is of the 15th of May 2024."""
    match = _UNIX.search(stem)
    if match is None or match[2] is not None:
        return False
    for form in _PACKED_DATES:
        with suppress(ValueError):
            if datetime.strptime(match[1], form).replace(tzinfo=UTC).year in _YEARS:
                return True
    return False


def _start_ns(stem: str, *, month_first: bool, zoned: bool, unix: bool) -> int | None:
    if match := _YEAR_FIRST.search(stem):
        found = _time(*match.groups(), zoned=zoned)
    elif match := _YEAR_LAST.search(stem):
        first, second, year, *rest = match.groups()
        found = _time(year, *((first, second) if month_first else (second, first)), *rest, zoned=zoned)
    elif match := _SIGNS.search(nfc(stem)):  # some systems take letters apart
        found = _time(*match.groups()[:3], "", *match.groups()[3:], None, None, None, zoned=False)
    elif match := _MONTH_NAMED.search(stem):
        day, month, year, *rest = match.groups()
        found = _time(year, str(_MONTHS.index(month.lower()) + 1), day, *rest, zoned=zoned)
    elif unix and (match := _UNIX.search(stem)):
        return int(match[1]) * 1_000_000_000 + int(match[2] or 0) * 1_000_000
    else:
        return None
    return None if found is None else (found[0] - datetime.fromtimestamp(0, UTC)) // timedelta(microseconds=1) * 1000


def _time(*groups: str | None, zoned: bool = True) -> tuple[datetime, bool] | None:
    """Of year, month, day, what is between, hour, minute, second, thousandths, A or P (of AM and PM), and the zone.

    The zone counts if ``zoned``. An hour that no half of a day has stays as it is, whichever half is said of it.
    """
    year, month, day, between, hour, minute, second, thousandths, half, zone = groups
    hours = int(hour or 0)
    if half is not None and 1 <= hours <= 12:
        hours = hours % 12 + (12 if half in "pP" else 0)
    try:
        parts = [int(part or 0) for part in (year, month, day, minute, second)]
        time = datetime(*parts[:3], hours, *parts[3:], tzinfo=UTC)  # type: ignore[misc,arg-type]
    except ValueError:
        return None
    time += timedelta(milliseconds=int(thousandths or 0))
    # a minus may only set a number apart, but for ISO 8601, where a T stands before the time of day
    if zone is None or not zoned or (zone[0] == "-" and "T" not in (between or "").upper()):
        return time, False
    if zone in "zZ":
        return time, True
    ahead = timedelta(hours=int(zone[1:3]), minutes=int(zone[-2:]))
    return time - ahead if zone[0] == "+" else time + ahead, True
