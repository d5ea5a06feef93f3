"""Several files of one camera: which comes first, which is missing, and when each begins.

Cameras cut long recordings: GoPro at 4 GB (``GH010042``, ``GH020042``; older ones ``GOPR0042``, ``GP010042``), others
with running numbers, recorders with the time of day in the name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import PurePath

from wibam_core.errors import UnreadableVideo
from wibam_core.video.name_times import likely, readings_of, without_times

_GOPRO = re.compile(r"(G[HXSL])(\d{2})(\d{4})")
_GOPRO_FIRST, _GOPRO_LATER = re.compile(r"(GOPR)(\d{4})"), re.compile(r"(GP)(\d{2})(\d{4})")
#: One of several views of a camera, in names whose date and time is replaced by a NUL: words, the lens (Insta360), and
#: a letter behind a number or the time (dashcams, DJI).
_VIEW = re.compile(
    r"(?<![a-z])(?P<word>front|rear|back|left|right|inside|wide|tele|thermal)(?![a-z])|"
    r"^(?:vid|lrv)_\0_(?P<lens>\d{2})_\d{3}$|"
    r"((?P<number>\d+)|\0)[-_]?[nepm]?(?P<letter>[friwtz])$",
    re.IGNORECASE,
)
#: Views that were recorded together begin so far apart at most, ns.
_TOGETHER_NS = 2_000_000_000

#: By how much more or less than an hour times may differ, where a camera notes when a file was finished, ns.
_QUARTER_NS = 900_000_000_000
#: How far a file's name and when it says that it was made may be from whole quarters of an hour apart, and how near to
#: one another files are at most made that one camera recorded.
_BESIDE_NS, _APART_NS = 10_000_000_000, 30_000_000_000

#: A time of day without a date, or a date with two digits for the year: its parts count no files.
_CLOCK = re.compile(r"(?<!\d)\d{1,2}([-_.:])\d{2}\1\d{2}(?!\d)")

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
    named = _gopro(names) or _dated(names, begins_ns) or _numbered(names) or _made(names, begins_ns)
    if named is not None:
        return sorted(enumerate(named), key=lambda one: one[1].place)
    raise UnreadableVideo(
        f"neither names nor times tell the order of {', '.join(names)}",
        hint="Number the names of a camera's files, e.g. north_1.mp4 and north_2.mp4.",
    )


def _check_one_view(names: Sequence[str]) -> None:
    """Raises:
    UnreadableVideo: names tell several views, which were recorded at the same time and not one after the other.
    """
    stems = [PurePath(name).stem for name in names]
    matches = [_VIEW.search(without_times(stem, "\0")) for stem in stems]
    found = [match for match in matches if match is not None]
    if len(found) < len(names) or not all(any(letter.isdigit() for letter in stem) for stem in stems):
        return
    views = [(match["word"] or match["lens"] or match["letter"]).lower() for match in found]
    if len(set(views)) == 1:
        return
    readings = readings_of(stems) or []
    for a, b in combinations(range(len(names)), 2):
        # A letter alone may mean anything: it is a view where a number or a moment is there twice.
        clear = not (found[a]["letter"] and found[b]["letter"])
        numbered = found[a]["number"] is not None and found[a]["number"] == found[b]["number"]
        at_once = bool(readings) and abs(readings[0][a] - readings[0][b]) <= _TOGETHER_NS
        if views[a] != views[b] and (clear or numbered or at_once):
            raise UnreadableVideo(
                f"{names[a]} and {names[b]} are of different views, which are no parts of one recording",
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


def _dated(names: Sequence[str], begins_ns: Sequence[int | None]) -> list[Named] | None:
    """Names with a date and time.

    Raises:
        UnreadableVideo: they also name several channels of a recorder; or day and month cannot be told apart, and
            nothing else tells the order.
    """
    readings = readings_of([PurePath(name).stem for name in names])
    if readings is None:
        return None
    channels = {int(match[1]): name for name in names if (match := _CHANNEL.search(without_times(name)))}
    if len(channels) > 1:
        raise UnreadableVideo(
            f"{' and '.join([*channels.values()][:2])} are of different channels, which are no parts of one recording",
            hint="Give each camera the files of its own channel alone.",
        )
    times = likely(readings, begins_ns)
    if times is not None:
        times = _over_summer_time(times, begins_ns) or times
        return _distinct([Named(name, (time,), None, time) for name, time in zip(names, times, strict=True)])
    orders = {tuple(sorted(range(len(names)), key=lambda index: times[index])) for times in readings}
    if len(orders) == 1:  # which comes first is certain, and how long after is not
        return _distinct([Named(name, (time,)) for name, time in zip(names, readings[0], strict=True)])
    made = _made(names, begins_ns)
    if made is None:
        raise UnreadableVideo(
            f"whether the day or the month comes first in {', '.join(names)} is not clear, and so not their order",
            hint="Put the year in front, e.g. 2024-12-02 10-00-00.mp4.",
        )
    return made


def _over_summer_time(times_ns: Sequence[int], begins_ns: Sequence[int | None]) -> tuple[int, ...] | None:
    """When the files say that they were made, if the times in their names are an hour more beside that in some than in
    others: names tell the time of day, which was set back or forward in between."""
    made = [begin for begin in begins_ns if begin is not None]
    if len(made) < len(times_ns):
        return None
    # files that were copied together say that they were made together, and those of an hour then look as over a change
    if any(later - earlier < _APART_NS for earlier, later in pairwise(sorted(made))):
        return None
    beside = [time - begin for time, begin in zip(times_ns, made, strict=True)]
    zones = {round(one / _QUARTER_NS) for one in beside}
    of_a_zone = all(abs(one - round(one / _QUARTER_NS) * _QUARTER_NS) < _BESIDE_NS for one in beside)
    return tuple(made) if of_a_zone and max(zones) - min(zones) == 4 and len(zones) == 2 else None


def _made(names: Sequence[str], begins_ns: Sequence[int | None]) -> list[Named] | None:
    """In the order of when the files say that they were made."""
    known = [begin for begin in begins_ns if begin is not None]
    if len(known) < len(names):
        return None
    return _distinct([Named(name, (begin,)) for name, begin in zip(names, known, strict=True)])


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
        begin = len("".join(part[:at]))
        if any(match.start() <= begin < match.end() for match in _CLOCK.finditer("".join(part))):
            gone = range(0)
        width = len(part[at]) if len(part) == longest else 0
        missing = tuple("".join([*part[:at], f"{n:0{width}d}", *part[at + 1 :]]) + PurePath(name).suffix for n in gone)
        named.append(Named(name, (number,), None, None, missing))
    return _distinct(named)


def _distinct(named: list[Named]) -> list[Named] | None:
    return named if len({item.place for item in named}) == len(named) else None
