"""Times as clients write them."""

from __future__ import annotations

import re
from datetime import UTC, datetime

from wibam_core.errors import InputError

_FORM = re.compile(
    r"(\d{4}-\d{2}-\d{2})[T ](\d{2}:\d{2}(?::\d{2})?)(?:[.,](\d{1,9}))?(Z|[+-]\d{2}:?\d{2})", re.IGNORECASE | re.ASCII
)
_EARLIEST_YEAR, _LATEST_YEAR = 1971, 2199


def parse_time(text: str) -> int:
    """Unix time (ns) of ``2026-07-01T08:00:00.25+02:00``: ISO 8601, to the nanosecond, with its offset from UTC.

    Raises:
        InputError: it is not that.
    """
    found = _FORM.fullmatch(text.strip())
    try:
        if found is None:
            raise ValueError
        zone = "+00:00" if found[4].upper() == "Z" else found[4]
        time = datetime.fromisoformat(f"{found[1]}T{found[2]}{zone}")
        if not _EARLIEST_YEAR <= time.year <= _LATEST_YEAR:
            raise ValueError
    except ValueError:
        raise InputError(
            f"{text[:60]!r} is no time", hint="Write it like 2026-07-01T08:00:00+02:00 or 2026-07-01T06:00:00Z."
        ) from None
    fraction_ns = int((found[3] or "").ljust(9, "0"))
    return round(time.timestamp()) * 1_000_000_000 + fraction_ns


def to_time(ns: int) -> datetime:
    """Unix time in ns as a time in UTC, to the microsecond."""
    return datetime.fromtimestamp(ns // 1_000_000_000, UTC).replace(microsecond=ns % 1_000_000_000 // 1000)
