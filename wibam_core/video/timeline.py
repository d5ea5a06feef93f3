"""One timeline of all frames of a recording, whatever files and clocks it consists of."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.recordings import Segment
from wibam_core.errors import UnreadableVideo
from wibam_core.video.chapters import Named, in_order
from wibam_core.video.packets import FilePackets, read_packets
from wibam_core.video.recording import Recording, RecordingFile
from wibam_core.video.sampling import nearest_times
from wibam_core.video.stamps import (
    LONGEST_PAUSE_NS,
    REORDER_FRAMES,
    Sorted,
    run_backwards,
    sort_stamps,
    usual_interval_ns,
)

IntArray = NDArray[np.int64]
PlacedBy = Literal["stamps", "timecode", "chapter", "creation_time", "name", "stated", "assumed"]

#: No frame of a recording has this time.
UNUSED = int(np.iinfo(np.int64).min)
_S = 1_000_000_000
_DAY_NS = 86_400 * _S
#: Clocks that count whole seconds, read at both ends.
_WHOLE_SECONDS_NS = 3 * _S // 2
_EXACT_NS = _S // 4


@dataclass(frozen=True, eq=False)
class TimedFile:
    """A file and the times of its frames.

    Attributes:
        packets: what it holds.
        times_ns: (packets,) the time of each packet's frame on the recording's timeline, or `UNUSED`.
        goes_on: it begins where the file before ends, so that one decoder reads through both.
    """

    packets: FilePackets
    times_ns: IntArray
    goes_on: bool

    @property
    def used_ns(self) -> IntArray:
        """Times of its frames, ascending."""
        return np.sort(self.times_ns[self.times_ns != UNUSED])


@dataclass(frozen=True, eq=False)
class Timeline:
    """All frames of a recording.

    Attributes:
        files: in order.
        segments: all, in order; one where the recording is of one piece.
        usual_ns: the usual interval between frames.
        unused: frames with a stray stamp, with one that another frame has, or with none.
        stray: those of them whose stamp is far from those around.
        doubled: frames at the beginning of a file that the file before had already, and that are left out.
        missing_files: names of files that should be there.
    """

    files: tuple[TimedFile, ...]
    segments: tuple[Segment, ...]
    usual_ns: int
    unused: int
    stray: int
    doubled: int
    missing_files: tuple[str, ...]

    @property
    def times_ns(self) -> IntArray:
        """(N,) times of all frames, ascending."""
        return np.sort(np.concatenate([file.used_ns for file in self.files]))


@dataclass(frozen=True)
class _Place:
    first_ns: int
    by: PlacedBy
    exact: bool


def read_timeline(recording: Recording, *, look: bool = False) -> Timeline:
    """Read all packets of a recording, and find when each frame was taken.

    The clock of the first file's first frame is the recording's; of a dated recording it is Unix time.

    Args:
        recording: its files.
        look: decode some pictures, too (`FilePackets.looks`).

    Raises:
        UnreadableVideo: a file cannot be read or holds fewer than two frames, or the order of the files is unknown.
    """
    if look:
        _check_different(recording)
    read = [read_packets(file, look=look) for file in recording.files]
    _check_filled(read)
    for packets in read:
        if run_backwards(packets.stamps_ns):
            raise UnreadableVideo(
                f"the time stamps of {packets.file.name} run backwards",
                hint="Take the recording as the camera made it, or export it anew, forwards.",
            )
    if recording.is_dated:
        read.sort(key=lambda packets: _started_ns(packets))
        return _joined([(packets, Named(packets.file.name, ())) for packets in read], dated=True)
    if len(read) == 1:
        return _joined([(read[0], Named(read[0].file.name, ()))])
    names = [packets.file.name for packets in read]
    order = in_order(names, [packets.created_ns for packets in read])
    return _joined([(read[index], named) for index, named in order])


def _check_filled(read: Sequence[FilePackets]) -> None:
    """Of several files one may hold a single frame, as a chapter that a camera began before it was switched off.

    Raises:
        UnreadableVideo: a file that holds no frame with a stamp, or files none of which is more than a picture.
    """
    moving = [len(packets.stamps_ns) > 0 and packets.stamps_ns.min() < packets.stamps_ns.max() for packets in read]
    for packets, is_moving in zip(read, moving, strict=True):
        frames = len(packets.stamps_ns)
        if not is_moving and (frames != 1 or not any(moving)):
            hint = "Leave it out, or copy it from the camera again." if len(read) > 1 else None
            named = {0: "no frame with a time stamp", 1: "a single frame"}
            holds = named.get(frames, f"{frames} frames that all have one time stamp")
            raise UnreadableVideo(f"{packets.file.name} holds {holds}: that is no recording", hint=hint)


def _check_different(recording: Recording) -> None:
    """Files that are said to begin at different times may be alike: a dark camera gives the same bytes every minute.

    Raises:
        UnreadableVideo: two files are copies of one.
    """
    by_size: dict[tuple[int, int | None], list[RecordingFile]] = {}
    for file in recording.files:
        if file.path.is_file():
            by_size.setdefault((file.path.stat().st_size, file.started_ns), []).append(file)
    seen: dict[tuple[str, int | None], str] = {}
    for file in (file for alike in by_size.values() if len(alike) > 1 for file in alike):
        with file.path.open("rb") as opened:
            content = (hashlib.file_digest(opened, "sha256").hexdigest(), file.started_ns)
        if content in seen:
            raise UnreadableVideo(f"{file.name} is a copy of {seen[content]}", hint="Leave one of the two out.")
        seen[content] = file.name


def _started_ns(packets: FilePackets) -> int:
    assert packets.file.started_ns is not None, "a dated recording"
    return packets.file.started_ns


def _joined(ordered: Sequence[tuple[FilePackets, Named]], *, dated: bool = False) -> Timeline:
    files: list[TimedFile] = []
    segments: list[Segment] = []
    missing: list[str] = []
    unused = stray = doubled = 0
    usual_ns = next(usual_interval_ns(packets.stamps_ns) for packets, _ in ordered if len(packets.stamps_ns) > 1)
    before: tuple[FilePackets, Named, int] | None = None
    for packets, named in ordered:
        stamps = _sorted(packets, usual_ns)
        place, goes_on = None, False
        if before is None and dated:
            place = _Place(_started_ns(packets), "stated", False)
        elif before is not None:
            whole = packets.with_lead_in()
            all_stamps = _sorted(whole, usual_ns)
            if dated:
                place = _as_stated(before[0], segments[-1].last_ns, whole, all_stamps, usual_ns)
            else:
                place = _place(before, segments[-1].last_ns, whole, named, all_stamps, usual_ns)
            goes_on = place.exact and _one_decoder(before[0], packets) and not packets.in_order
            if goes_on:
                packets, stamps = whole, all_stamps
            elif len(packets.lead_in):
                lead_ns = int(stamps.times_ns[stamps.kept].min() - all_stamps.times_ns[all_stamps.kept].min())
                place = replace(place, first_ns=place.first_ns + max(lead_ns, 0))
        if place is not None and named.missing_before:
            gap_ns = place.first_ns - segments[-1].last_ns
            if named.sure or place.by == "assumed" or gap_ns > 2 * _S:
                missing += named.missing_before
        elif place is None and named.sure:
            missing += named.missing_before
        first_raw_ns = int(stamps.times_ns[stamps.kept].min())
        shift_ns = 0 if place is None else place.first_ns - first_raw_ns
        times, kept = stamps.times_ns + shift_ns, stamps.kept.copy()
        if segments:
            again = kept & _are_among(times, files[-1].used_ns, usual_ns // 2)
            if not goes_on:
                again |= kept & (times <= segments[-1].last_ns)
            doubled += int(again.sum())
            kept &= ~again
        of_packets = np.full(packets.packets, UNUSED, dtype=np.int64)
        of_packets[packets.numbers[kept]] = times[kept]
        for number, stretch in enumerate(stamps.segments):
            of_it = times[stretch.indices[kept[stretch.indices]]]
            if not len(of_it):
                continue
            by: PlacedBy = "assumed" if stretch.jump_before else "stamps"
            if number == 0 and place is not None:
                by = place.by
            segments.append(
                Segment(
                    # in presentation order the first frames of a file may lie before the last ones of the file before
                    first_ns=max(int(of_it.min()), segments[-1].last_ns + 1 if segments else UNUSED),
                    last_ns=int(of_it.max()),
                    frames=len(of_it),
                    file=packets.file.name,
                    placed_by=by,
                )
            )
        stray += stamps.stray
        unused += packets.unstamped + len(stamps.kept) - int(stamps.kept.sum())
        files.append(TimedFile(packets, of_packets, goes_on))
        before = (packets, named, first_raw_ns + shift_ns)
    return Timeline(tuple(files), tuple(segments), usual_ns, unused, stray, doubled, tuple(missing))


def _sorted(packets: FilePackets, usual_ns: int) -> Sorted:
    return sort_stamps(packets.stamps_ns, usual_ns if len(packets.stamps_ns) == 1 else None)


def _are_among(times_ns: IntArray, others_ns: IntArray, tolerance_ns: int) -> NDArray[np.bool_]:
    """Whether each of the times (N,) is one of the others (M,), which ascend, but for a tolerance."""
    found = nearest_times(others_ns, times_ns, tolerance_ns)
    return np.array([time is not None for time in found], dtype=bool)


def _one_decoder(before: FilePackets, after: FilePackets) -> bool:
    return before.codec == after.codec and before.extradata == after.extradata


def _place(
    before: tuple[FilePackets, Named, int],
    last_ns: int,
    after: FilePackets,
    named: Named,
    stamps: Sorted,
    usual_ns: int,
) -> _Place:
    """When a file begins, by the best that there is to tell.

    Args:
        before: the file before, what its name says, and when its first frame was taken.
        last_ns: when its last frame was taken.
        after: the file.
        named: what its name says.
        stamps: its stamps, sorted.
        usual_ns: the usual interval between frames.
    """
    packets, name_before, began_ns = before
    next_ns = last_ns + usual_ns
    by_stamps = _by_stamps(packets, stamps, last_ns)
    if by_stamps is not None:
        return _Place(by_stamps, "stamps", -REORDER_FRAMES * usual_ns <= by_stamps - next_ns <= 2 * usual_ns)
    if packets.timecode_ns is not None and after.timecode_ns is not None:
        starts_ns = began_ns + (after.timecode_ns - packets.timecode_ns) % _DAY_NS
        if abs(starts_ns - next_ns) <= 1.5 * usual_ns:
            return _Place(next_ns, "timecode", True)
        if next_ns < starts_ns < next_ns + _DAY_NS // 2:
            return _Place(starts_ns, "timecode", False)
    missing = len(named.missing_before) if named.sure else 0
    chapter = named.chapter is not None and name_before.chapter is not None and not missing
    chapter = chapter and named.place[0] == name_before.place[0]
    lasts_ns = int(np.ptp(stamps.times_ns[stamps.kept])) + usual_ns
    for by, first, second in (
        ("creation_time", packets.created_ns, after.created_ns),
        ("name", name_before.starts_ns, named.starts_ns),
    ):
        if first is None or second is None or second <= first:
            continue
        slack_ns = _WHOLE_SECONDS_NS if first % _S == second % _S == 0 else _EXACT_NS
        starts_ns = began_ns + second - first
        if starts_ns < next_ns - slack_ns:  # some cameras write when a file was finished
            starts_ns = next_ns + second - first - lasts_ns
        if abs(starts_ns - next_ns) <= slack_ns:
            return _Place(next_ns, "chapter" if chapter else by, chapter)  # type: ignore[arg-type]
        if starts_ns > next_ns:
            return _Place(starts_ns, by, False)  # type: ignore[arg-type]
    if chapter:
        return _Place(next_ns, "chapter", True)
    return _Place(next_ns + missing * (last_ns - began_ns + usual_ns), "assumed", False)


def _as_stated(before: FilePackets, last_ns: int, after: FilePackets, stamps: Sorted, usual_ns: int) -> _Place:
    """When a file of a dated recording begins: as stated, but right behind the one before where that fits as well."""
    started_ns, next_ns = _started_ns(after), last_ns + usual_ns
    slack_ns = _WHOLE_SECONDS_NS if started_ns % _S == 0 else _EXACT_NS
    if abs(started_ns - next_ns) > slack_ns:
        return _Place(started_ns, "stated", False)
    by_stamps = _by_stamps(before, stamps, last_ns)
    if by_stamps is not None and -REORDER_FRAMES * usual_ns <= by_stamps - next_ns <= 2 * usual_ns:
        return _Place(by_stamps, "stamps", True)
    return _Place(next_ns, "stated", False)


def _by_stamps(before: FilePackets, stamps: Sorted, last_ns: int) -> int | None:
    """When a file begins whose stamps go on where those of the file before end; None where they do not.

    Stamps that both files have, since a recorder wrote some frames twice, are the same frames.
    """
    first_raw_ns, last_raw_ns = int(before.stamps_ns[0]), int(before.stamps_ns.max())
    times_ns = stamps.times_ns[stamps.kept]
    starts, ends = int(times_ns.min()), int(times_ns.max())
    if starts <= first_raw_ns or ends <= last_raw_ns or starts > last_raw_ns + LONGEST_PAUSE_NS:
        return None
    if starts <= last_raw_ns and last_raw_ns - starts > 0.5 * (last_raw_ns - first_raw_ns):
        return None
    return last_ns + starts - last_raw_ns
