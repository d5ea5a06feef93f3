"""Dates and times in files' names, as cameras and recorders write them.

A date with the year in front is read by itself. One with the day or the month in front is not: 02-12-2024 is in
February or in December. All files of a camera are named by one rule, so that the rule is sought under which all names
together make sense.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from itertools import pairwise

_TIME_OF_DAY = r"(\d{2})[-_.:h]?(\d{2})[-_.:m]?(\d{2})(?:[.,]?(\d{3}))?(?!\d)(Z(?![A-Za-z]))?"
_YEAR_FIRST = re.compile(r"(?<!\d)((?:19|20)\d{2})[-_.]?(\d{2})[-_.]?(\d{2})[-_.T ]{0,3}" + _TIME_OF_DAY)
_YEAR_LAST = re.compile(r"(?<!\d)(\d{2})[-_.](\d{2})[-_.]((?:19|20)\d{2})[-_.T ]{1,3}" + _TIME_OF_DAY)

_DAY_NS = 86_400_000_000_000


def without_times(text: str, instead: str = "") -> str:
    """The text with something else in the place of each date and time, and of the Z behind one that is in UTC."""
    return _YEAR_LAST.sub(instead, _YEAR_FIRST.sub(instead, text))


def time_in(stem: str) -> tuple[datetime, bool] | None:
    """A date and time with the year in front, as if it were UTC, and whether a Z says that it is; None without one.

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
    by_rule = [[_start_ns(stem, month_first=month_first) for stem in stems] for month_first in (False, True)]
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


def _start_ns(stem: str, *, month_first: bool) -> int | None:
    if match := _YEAR_FIRST.search(stem):
        found = _time(*match.groups())
    elif match := _YEAR_LAST.search(stem):
        first, second, year, *rest = match.groups()
        found = _time(year, *((first, second) if month_first else (second, first)), *rest)
    else:
        return None
    return None if found is None else (found[0] - datetime.fromtimestamp(0, UTC)) // timedelta(microseconds=1) * 1000


def _time(*groups: str | None) -> tuple[datetime, bool] | None:
    *parts, thousandths, is_utc = groups
    try:
        time = datetime(*(int(part or 0) for part in parts), tzinfo=UTC)  # type: ignore[misc,arg-type]
    except ValueError:
        return None
    return time + timedelta(milliseconds=int(thousandths or 0)), bool(is_utc)
