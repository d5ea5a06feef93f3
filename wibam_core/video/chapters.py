"""Several files of one camera: which comes first, which is missing, and when each begins.

Cameras cut long recordings: GoPro at 4 GB (``GH010042``, ``GH020042``; older ones ``GOPR0042``, ``GP010042``), others
with running numbers, recorders with the time of day in the name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import PurePath

from wibam_core.errors import UnreadableVideo

_GOPRO = re.compile(r"(G[HXSL])(\d{2})(\d{4})")
_GOPRO_FIRST, _GOPRO_LATER = re.compile(r"(GOPR)(\d{4})"), re.compile(r"(GP)(\d{2})(\d{4})")
_DATE_TIME = re.compile(
    r"(?<!\d)((?:19|20)\d{2})[-_.]?(\d{2})[-_.]?(\d{2})[-_.T ]{0,3}(\d{2})[-_.:h]?(\d{2})[-_.:m]?(\d{2})(\d{3})?(?!\d)"
)
#: The same with the day, or the month, in front.
_DAY_FIRST = re.compile(
    r"(?<!\d)(\d{2})[-_.](\d{2})[-_.]((?:19|20)\d{2})[-_.T ]{1,3}(\d{2})[-_.:h]?(\d{2})[-_.:m]?(\d{2})(\d{3})?(?!\d)"
)
#: One of several views of a camera: words, a letter behind the number (dashcams, DJI), the lens (Insta360).
_VIEW = re.compile(
    r"(?<![a-z])(front|rear|back|left|right|inside|wide|tele|thermal)(?![a-z])|\d[-_]?[nepm]?([friwtz])$|"
    r"^(?:vid|lrv)_\d{8}_\d{6}_(\d{2})_\d{3}$",
    re.IGNORECASE,
)

_CHANNEL = re.compile(r"(?:ch|channel|cam|camera)[ _-]?(\d{1,3})(?!\d)", re.IGNORECASE)


@dataclass(frozen=True)
class Named:
    """What a file's name says.

    Attributes:
        name: the name.
        place: by which files are sorted.
        chapter: counted within one recording, which a camera cuts without losing a frame; None: no such count.
        starts_ns: a time of day in the name, as if it were UTC.
        missing_before: names of files that should lie between the one before and this one.
        sure: they are missing for certain; else only if the times say so, too.
    """

    name: str
    place: tuple[int | str, ...]
    chapter: int | None = None
    starts_ns: int | None = None
    missing_before: tuple[str, ...] = ()
    sure: bool = False


def in_order(names: Sequence[str], begins_ns: Sequence[int | None]) -> list[tuple[int, Named]]:
    """The files in order: the index of each, and what its name says.

    Args:
        names: all names.
        begins_ns: when the files themselves say that they begin, for names that do not say it.

    Raises:
        UnreadableVideo: neither tells the order, or they are of several views.
    """
    _check_one_view(names)
    for read in (_gopro, _dated, _numbered):
        named = read(names)
        if named is not None:
            order = sorted(range(len(names)), key=lambda index: named[index].place)
            return [(index, named[index]) for index in order]
    known = [begin for begin in begins_ns if begin is not None]
    if len(set(known)) == len(names):
        order = sorted(range(len(names)), key=lambda index: begins_ns[index] or 0)
        return [(index, Named(names[index], (place,))) for place, index in enumerate(order)]
    raise UnreadableVideo(
        f"neither names nor times tell the order of {', '.join(names)}",
        hint="Number the names of a camera's files, e.g. north_1.mp4 and north_2.mp4.",
    )


def _check_one_view(names: Sequence[str]) -> None:
    """Raises:
    UnreadableVideo: names tell several views, which were recorded at the same time and not one after the other.
    """
    views: dict[str, str] = {}
    for name in names:
        stem = PurePath(name).stem
        match = _VIEW.search(stem)
        if match is None or not any(letter.isdigit() for letter in stem):
            return
        views.setdefault(next(group for group in match.groups() if group).lower(), name)
    if len(views) > 1:
        raise UnreadableVideo(
            f"{' and '.join([*views.values()][:2])} are of different views, which are no parts of one recording",
            hint="Make each view a camera of its own, with a calibration of its own.",
        )


def _gopro(names: Sequence[str]) -> list[Named] | None:
    found: list[tuple[str, str, int, int]] = []
    for name in names:
        stem = PurePath(name).stem.upper()
        if match := _GOPRO.fullmatch(stem) or _GOPRO_LATER.fullmatch(stem):
            found.append((name, match[1], int(match[3]), int(match[2])))
        elif match := _GOPRO_FIRST.fullmatch(stem):
            found.append((name, match[1], int(match[2]), 0))
        else:
            return None
    there = {(video, chapter) for _, _, video, chapter in found}
    named = []
    for name, kind, video, chapter in found:
        old = kind in ("GOPR", "GP")
        missing: list[str] = []
        earlier = chapter - 1
        while earlier >= (0 if old else 1) and (video, earlier) not in there:
            missing.insert(0, _gopro_name(kind, video, earlier) + PurePath(name).suffix)
            earlier -= 1
        named.append(Named(name, (video, chapter), chapter, None, tuple(missing), sure=True))
    return _distinct(named)


def _gopro_name(kind: str, video: int, chapter: int) -> str:
    if kind == "GP":
        return f"GP{chapter:02d}{video:04d}" if chapter else f"GOPR{video:04d}"
    return f"{kind}{chapter:02d}{video:04d}"


def _dated(names: Sequence[str]) -> list[Named] | None:
    """Names with a date and time.

    Raises:
        UnreadableVideo: they also name several channels of a recorder.
    """
    named = []
    for name in names:
        starts_ns = _starts_ns(PurePath(name).stem)
        if starts_ns is None:
            return None
        named.append(Named(name, (starts_ns,), None, starts_ns))
    channels = {
        int(match[1]): name
        for name in names
        if (match := _CHANNEL.search(_DAY_FIRST.sub("", _DATE_TIME.sub("", name))))
    }
    if len(channels) > 1:
        raise UnreadableVideo(
            f"{' and '.join([*channels.values()][:2])} are of different channels, which are no parts of one recording",
            hint="Give each camera the files of its own channel alone.",
        )
    return _distinct(named)


def _starts_ns(stem: str) -> int | None:
    """The date and time in a name, as if it were UTC; of the day and the month the one above 12, else the first, is the
    day. None without one."""
    parts: list[int]
    if match := _DATE_TIME.search(stem):
        parts = [int(part) for part in match.groups()[:6]]
    elif match := _DAY_FIRST.search(stem):
        day, month, year, *time = (int(part) for part in match.groups()[:6])
        parts = [year, *((day, month) if month > 12 else (month, day)), *time]
    else:
        return None
    with suppress(ValueError):
        time_of = datetime(*parts, tzinfo=UTC)  # type: ignore[misc,arg-type]
        return round(time_of.timestamp()) * 1_000_000_000 + int(match[7] or 0) * 1_000_000
    return None


def _numbered(names: Sequence[str]) -> list[Named] | None:
    """Names that differ in one number; one of them may have none, and is the first."""
    parts = [re.split(r"(\d+)", PurePath(name).stem) for name in names]
    longest = max(len(part) for part in parts)
    whole = [part for part in parts if len(part) == longest]
    differ = [i for i in range(longest) if len({part[i].lower() for part in whole}) > 1]
    if len(whole) < len(names) - 1 or len(differ) > 1 or longest == 1 or any(i % 2 == 0 for i in differ):
        return None
    at = differ[0] if differ else longest - 2
    numbers = [int(part[at]) if len(part) == longest else -1 for part in parts]
    if len(whole) < len(names):
        plain = "".join(parts[numbers.index(-1)])
        if "".join(whole[0][:at]).rstrip(" _-(").lower() != plain.lower():
            return None
    there = sorted(set(numbers))
    named = []
    for name, part, number in zip(names, parts, numbers, strict=True):
        before = max((other for other in there if 0 <= other < number), default=None)
        gone = range(before + 1, number) if before is not None and number - before <= 10 else range(0)
        width = len(part[at]) if len(part) == longest else 0
        missing = tuple("".join([*part[:at], f"{n:0{width}d}", *part[at + 1 :]]) + PurePath(name).suffix for n in gone)
        named.append(Named(name, (number,), None, None, missing))
    return _distinct(named)


def _distinct(named: list[Named]) -> list[Named] | None:
    return named if len({item.place for item in named}) == len(named) else None
