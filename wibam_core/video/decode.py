"""Frames by presentation timestamp. Frame numbers do not exist here: cameras drop frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from av.video.codeccontext import VideoCodecContext
from av.video.frame import VideoFrame

from wibam_core.video.packets import numbered
from wibam_core.video.picture import Deinterlacer, Image, Orientation, Orientations, Size, to_bgr
from wibam_core.video.recording import Recording
from wibam_core.video.source import open_video
from wibam_core.video.timeline import UNUSED, TimedFile, read_timeline
from wibam_core.video.windows import Window, Windows

#: A frame is shown after at most so many that are decoded later: the largest buffer of H.264 and H.265.
_LONGEST_WAIT = 17

_Frame = tuple[int, VideoFrame, Orientation]


@dataclass(frozen=True, eq=False)
class NearestFrame:
    """The frame nearest to a wanted time.

    Attributes:
        target_ns: the wanted time. time_ns: the frame's own time. Both on the recording's clock.
        image_bgr: (H, W, 3) uint8. Two targets nearest to one frame share one image.
    """

    target_ns: int
    time_ns: int
    image_bgr: Image


@dataclass(frozen=True, eq=False)
class Watcher:
    """Somebody who is shown windows of every frame on the way.

    Attributes:
        windows: where they are in the pictures, px.
        size_px: width and height that pictures are brought to where they have others.
        show: is given each frame's time, and the windows' pictures, (H, W, 3) uint8, BGR.
    """

    windows: Sequence[Window]
    size_px: Size
    show: Callable[[int, list[Image]], None]


def decode(
    recording: Path | Recording, *, size_px: Size | None = None, width_px: int | None = None, threads: int = 1
) -> Iterator[tuple[int, Image]]:
    """Every frame of a recording: (presentation time in ns, BGR image (H, W, 3) uint8), times strictly increasing.

    Times are those of `wibam_core.video.probe.measure`. Damaged frames are left out, interlaced ones deinterlaced.

    Args:
        recording: its file or files.
        size_px: width and height that pictures are brought to where they have others; None: those of the first one.
        width_px: then shrink frames that are wider to this width, by area, keeping the aspect ratio.
        threads: decoding threads.

    Raises:
        UnreadableVideo: a file cannot be opened.
    """
    for time_ns, frame, orientation in _frames(recording, threads):
        size_px = size_px or orientation.size((frame.width, frame.height))
        yield time_ns, to_bgr(frame, orientation, size_px, width_px)


def frames_nearest(
    recording: Path | Recording,
    times_ns: Iterable[int],
    *,
    tolerance_ns: int,
    width_px: int | None = None,
    threads: int = 1,
) -> Iterator[NearestFrame]:
    """For each wanted time the nearest frame, in one pass over the file.

    Wanted times without a frame within the tolerance yield nothing. Only chosen frames are converted to BGR.

    Args:
        recording: its file or files.
        times_ns: wanted times on the recording's clock, ascending.
        tolerance_ns: largest distance of a frame from its wanted time.
        width_px: as in `decode`.
        threads: decoding threads.

    Raises:
        UnreadableVideo: the file cannot be opened.
        ValueError: the wanted times descend.
    """
    one_pass = OnePass(recording, width_px=width_px, threads=threads)
    for target in times_ns:
        found = one_pass.nearest(target, tolerance_ns)
        if found is not None:
            yield found


class OnePass:
    """Looks for frames in one pass over a recording, which is opened when the first one is asked for.

    Args:
        recording: its file or files.
        among: times of the frames that count; None: all.
        size_px, width_px: as in `decode`.
        threads: decoding threads.
        watcher: who is shown windows of every frame that is passed, whether it counts or not.
    """

    def __init__(
        self,
        recording: Path | Recording,
        *,
        among: Set[int] | None = None,
        size_px: Size | None = None,
        width_px: int | None = None,
        threads: int = 1,
        watcher: Watcher | None = None,
    ) -> None:
        frames = _frames(recording, threads)
        if watcher is not None:
            frames = _shown(frames, watcher)
        self._frames = frames if among is None else (frame for frame in frames if frame[0] in among)
        self._size_px, self._width_px = size_px, width_px
        self._before: _Frame | None = None
        self._after: _Frame | None = None
        self._last_target_ns: int | None = None
        self._chosen: NearestFrame | None = None

    def pass_to(self, target_ns: int) -> None:
        """Read all frames before a time, and the first one from there on.

        Raises:
            UnreadableVideo: the file cannot be opened.
            ValueError: a later time was asked for before.
        """
        if self._last_target_ns is None:
            self._after = next(self._frames, None)
        elif target_ns < self._last_target_ns:
            raise ValueError("wanted times must ascend")
        self._last_target_ns = target_ns
        while self._after is not None and self._after[0] < target_ns:
            self._before, self._after = self._after, next(self._frames, None)

    def finish(self) -> None:
        """Read all frames that are left, for whoever watches them."""
        for _ in self._frames:
            pass

    def nearest(self, target_ns: int, tolerance_ns: int) -> NearestFrame | None:
        """The frame nearest to a time (the earlier of two equally near), None where none is within the tolerance.

        Raises:
            UnreadableVideo: the file cannot be opened.
            ValueError: a later time was asked for before.
        """
        self.pass_to(target_ns)
        candidates = [frame for frame in (self._before, self._after) if frame is not None]
        if not candidates:
            return None
        time_ns, frame, orientation = min(candidates, key=lambda candidate: abs(candidate[0] - target_ns))
        if abs(time_ns - target_ns) > tolerance_ns:
            return None
        if self._chosen is None or self._chosen.time_ns != time_ns:
            self._size_px = self._size_px or orientation.size((frame.width, frame.height))
            image = to_bgr(frame, orientation, self._size_px, self._width_px)
        else:
            image = self._chosen.image_bgr
        self._chosen = NearestFrame(target_ns, time_ns, image)
        return self._chosen


def _shown(frames: Iterator[_Frame], watcher: Watcher) -> Iterator[_Frame]:
    """Pass frames on, showing windows of each."""
    windows = Windows(watcher.windows, watcher.size_px)
    for time_ns, frame, orientation in frames:
        watcher.show(time_ns, windows.of(frame, orientation))
        yield time_ns, frame, orientation


def _frames(recording: Path | Recording, threads: int) -> Iterator[_Frame]:
    """Sound frames in the order of time, each time once."""
    recording = Recording.at(recording) if isinstance(recording, Path) else recording
    deinterlacer = Deinterlacer()
    last_ns: int | None = None
    for time_ns, frame, orientation in _timed(recording, threads):
        if frame.is_corrupt or (last_ns is not None and time_ns <= last_ns):
            continue
        last_ns = time_ns
        yield from deinterlacer.push(time_ns, frame, orientation)
    yield from deinterlacer.flush()


def _timed(recording: Recording, threads: int) -> Iterator[_Frame]:
    """Decoded frames with their times, those without one left out. Packets are numbered, and so frames find theirs."""
    decoder: VideoCodecContext | None = None
    clock = _FrameClock()
    with ExitStack() as opened:
        for file in read_timeline(recording).files:
            if not file.goes_on:
                yield from clock.timed(_decoded(decoder, None))
                opened.close()
            path, name = file.packets.file.path, file.packets.file.name
            container, stream = opened.enter_context(open_video(path, threads, name))
            if not file.goes_on or decoder is None:
                decoder = stream.codec_context
            first = clock.add(file)
            for number, packet in numbered(container, stream):
                packet.pts = packet.dts = first + number
                yield from clock.timed(_decoded(decoder, packet))
        yield from clock.timed(_decoded(decoder, None))


def _decoded(decoder: VideoCodecContext | None, packet: av.Packet | None) -> list[VideoFrame]:
    """What comes out when a packet goes in, nothing where the decoder refuses it; None: all that is left."""
    if decoder is not None:
        with suppress(av.FFmpegError, EOFError):
            return list(decoder.decode(packet))
    return []


class _FrameClock:
    """Times of decoded frames by the numbers of their packets, over all files of a recording."""

    def __init__(self) -> None:
        self._files: list[tuple[int, TimedFile, _ShownOrder | None]] = []
        self._orientations = Orientations()

    def add(self, file: TimedFile) -> int:
        """Go on with a file; returns the number of its first packet."""
        first = self._files[-1][0] + len(self._files[-1][1].times_ns) if self._files else 0
        self._orientations = self._orientations if file.goes_on else Orientations()
        self._files.append((first, file, _ShownOrder(file) if file.packets.in_order else None))
        return first

    def timed(self, frames: Iterable[VideoFrame]) -> Iterator[_Frame]:
        """Frames in the order shown, with their times, and how they are shown."""
        for frame in frames:
            if frame.pts is None:
                continue
            first, file, order = next(entry for entry in reversed(self._files) if entry[0] <= frame.pts)
            number = frame.pts - first
            if number < len(file.times_ns):
                time_ns = int(file.times_ns[number]) if order is None else order.time_ns(number)
                if time_ns != UNUSED:
                    yield time_ns, frame, self._orientations.of(frame)


class _ShownOrder:
    """Times of a file's frames where its stamps say in which order they are decoded: the first shown has the first."""

    def __init__(self, file: TimedFile) -> None:
        self._used = np.flatnonzero(file.times_ns != UNUSED).tolist()
        self._rank = {number: rank for rank, number in enumerate(self._used)}
        self._times_ns = file.used_ns.tolist()
        self._shown: set[int] = set()
        self._settled = self._latest = 0

    def time_ns(self, number: int) -> int:
        """Of the frame that is shown next, by the number of its packet."""
        rank = self._rank.get(number)
        if rank is None:
            return UNUSED
        self._latest = max(self._latest, rank)
        while self._settled < self._latest - _LONGEST_WAIT:  # what was not shown until now is damaged
            self._shown.discard(self._settled)
            self._settled += 1
        place = len(self._shown) + self._settled
        self._shown.add(rank)
        return self._times_ns[place] if place < len(self._times_ns) else UNUSED
