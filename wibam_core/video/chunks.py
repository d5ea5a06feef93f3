"""Cutting a running stream into files, at key frames and without touching its pictures.

A stream counts time from a start of its own, so when a picture was taken follows from when its packet arrived. Packets
come late, never early: after a pause in the network several at once. So the least of "arrived less stamp" over a chunk
says when its first picture was taken, up to what the camera and the network take at best.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path

import av
from av.container import OutputContainer
from av.packet import Packet
from av.video.stream import VideoStream

from wibam_core.video.source import ns_from_pts

#: Of files that are being written; recorders' folders are looked through for others.
HIDDEN = "."
SUFFIX = ".mkv"
#: A decoder gets packets by times that lie so far before those at which they are shown: enough for any order.
_REORDERED_S = Fraction(1, 2)
#: Stamps that run ahead of the clock by more have jumped.
_JUMP_NS = 2_000_000_000
#: Shorter pieces are no footage: nothing can be followed in them.
_SHORTEST_NS = 1_000_000_000
#: What is written can be read about a second later, should the program be killed.
_AT_ONCE = {"cluster_time_limit": "1000", "flush_packets": "1"}
#: A stream that has had no key frame for so long after its beginning can be asked for one by connecting again.
_KEY_FRAME_WITHIN_NS = 60_000_000_000
#: The name of a file in the making is mended when its beginning is known better by so much.
_BETTER_NS = 20_000_000


@dataclass(frozen=True)
class Chunk:
    """A file of a stream that is complete.

    Attributes:
        path: its name says when it began (`name_of`).
        began_ns, ended_ns: when its first and its last picture were taken, Unix time.
    """

    path: Path
    began_ns: int
    ended_ns: int


def name_of(began_ns: int) -> str:
    """The name of a file that began at a Unix time, to the millisecond."""
    began = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=round(began_ns / 1e6))
    return f"{began:%Y-%m-%d_%H-%M-%S}.{began.microsecond // 1000:03d}Z{SUFFIX}"


class ChunkCutter:
    """Takes a stream's packets one by one and writes files; a context manager, which completes the last one.

    A file begins with a key frame, and ends before the first one after ``length_s``, by the stamps or by the clock, or
    once it has half the bytes that it may have. It ends at once where stamps jump, or with all those bytes: what comes
    between that and the next key frame cannot be decoded and is left out. While it is written its name begins with a
    dot; one that was left behind by a killed program is completed by `recovered`.

    Args:
        folder: for the files.
        length_s: of a chunk, about.
        to_unix_ns: from the clock by which packets arrive, which is never set, to Unix time as it is known now.
        complete: told each file.
        most_bytes: of a file.

    Attributes:
        frozen: a file was left out since its stamps had hardly moved over its whole length.
    """

    def __init__(
        self,
        folder: Path,
        length_s: float,
        to_unix_ns: Callable[[int], int],
        complete: Callable[[Chunk], None],
        most_bytes: int,
    ) -> None:
        self._folder = folder
        self._length_ns = round(length_s * 1e9)
        self._to_unix_ns = to_unix_ns
        self._complete = complete
        self._most_bytes = most_bytes
        self._open: _OpenChunk | None = None
        self._first_arrived_ns = self._last_arrived_ns = -1
        self.frozen = False

    def __enter__(self) -> ChunkCutter:
        return self

    def __exit__(self, *details: object) -> None:
        self.close()

    def add(self, packet: Packet, stream: VideoStream, arrived_ns: int) -> None:
        """Take a packet of ``stream`` that arrived at a time; one without a stamp is left out.

        Raises:
            OSError: it cannot be written.
        """
        if self._first_arrived_ns < 0:
            self._first_arrived_ns = arrived_ns
        self._last_arrived_ns = arrived_ns
        if packet.pts is None or packet.time_base is None or not packet.size:
            return
        time_ns = ns_from_pts(packet.pts, packet.time_base)
        chunk = self._open
        if chunk is not None and (
            chunk.jumps(packet.pts, time_ns, arrived_ns)
            or chunk.written_bytes >= self._most_bytes
            or (packet.is_keyframe and self._is_long(chunk, time_ns))
        ):
            self.close()
        if self._open is None:
            if not packet.is_keyframe:
                return
            self._first_arrived_ns = arrived_ns
            self._open = _OpenChunk(self._folder, stream, packet.pts, time_ns, arrived_ns, self._to_unix_ns)
        self._open.write(packet, time_ns, arrived_ns)

    @property
    def writing(self) -> bool:
        """There was a key frame, with which a file has begun."""
        return self._open is not None

    @property
    def overdue(self) -> bool:
        """A file has become twice as long as it should, or none can begin: the stream hardly has key frames."""
        chunk, arrived_over_ns = self._open, self._last_arrived_ns - self._first_arrived_ns
        if chunk is None:
            return arrived_over_ns > min(2 * self._length_ns, _KEY_FRAME_WITHIN_NS)
        return max(chunk.last_ns - chunk.first_ns, arrived_over_ns) > 2 * self._length_ns

    def _is_long(self, chunk: _OpenChunk, time_ns: int) -> bool:
        lengths_ns = time_ns - chunk.first_ns, self._last_arrived_ns - self._first_arrived_ns
        return max(lengths_ns) >= self._length_ns or 2 * chunk.written_bytes >= self._most_bytes

    def close(self) -> None:
        """Complete the file that is being written, if any."""
        chunk, self._open = self._open, None
        if chunk is None:
            return
        arrived_over_ns = self._last_arrived_ns - self._first_arrived_ns
        self._first_arrived_ns = self._last_arrived_ns
        if (made := chunk.close()) is not None:
            self._complete(made)
        elif arrived_over_ns >= max(self._length_ns, _SHORTEST_NS):
            self.frozen = True


class _OpenChunk:
    """A file that is being written, and what is known of its time. Times are the stream's unless they say otherwise."""

    def __init__(
        self,
        folder: Path,
        stream: VideoStream,
        first_pts: int,
        first_ns: int,
        arrived_ns: int,
        to_unix_ns: Callable[[int], int],
    ) -> None:
        self.first_ns = self.last_ns = first_ns
        self.written_bytes = 0
        self._folder = folder
        self._to_unix_ns = to_unix_ns
        self._first_pts = first_pts
        self._least_late_ns = arrived_ns - first_ns
        self._arrived_ns = arrived_ns
        self._last_dts: int | None = None
        self._named_ns = self._began_ns
        self._path = folder / (HIDDEN + name_of(self._named_ns))
        self._container: OutputContainer = av.open(str(self._path), "w", format="matroska", options=dict(_AT_ONCE))
        try:
            self._stream = self._container.add_stream_from_template(stream)
        except BaseException:
            self._container.close()
            self._path.unlink()
            raise

    def jumps(self, pts: int, time_ns: int, arrived_ns: int) -> bool:
        """The stamp of the next packet runs ahead of the clock, or back."""
        back = self._last_dts is not None and pts - self._first_pts <= self._last_dts
        return back or time_ns - self.last_ns > arrived_ns - self._arrived_ns + _JUMP_NS

    def write(self, packet: Packet, time_ns: int, arrived_ns: int) -> None:
        assert packet.pts is not None and packet.time_base is not None
        # cameras' packets come in decoding order with the times at which they are shown, and seldom with another
        pts = packet.pts - self._first_pts
        dts = pts - int(_REORDERED_S / packet.time_base)
        dts = dts if self._last_dts is None else max(dts, self._last_dts + 1)
        packet.pts, packet.dts, packet.stream = pts, dts, self._stream
        self._last_dts = dts
        self.written_bytes += packet.size
        try:
            self._container.mux_one(packet)
        except av.FFmpegError as error:
            raise OSError(error.errno, error.strerror) from error
        self.last_ns = max(self.last_ns, time_ns)
        self._arrived_ns = arrived_ns
        self._least_late_ns = min(self._least_late_ns, arrived_ns - time_ns)
        if self._named_ns - self._began_ns >= _BETTER_NS:
            self._named_ns = self._began_ns
            self._path = self._path.rename(self._folder / (HIDDEN + name_of(self._named_ns)))

    def close(self) -> Chunk | None:
        """Give the file its name; None where it is too short, and gone."""
        with suppress(av.FFmpegError):  # as of a full disk: what was written before can be read
            self._container.close()
        if self.last_ns - self.first_ns < _SHORTEST_NS:
            self._path.unlink()
            return None
        began_ns = self._began_ns
        path = self._path.rename(self._folder / name_of(began_ns))
        return Chunk(path, began_ns, began_ns + self.last_ns - self.first_ns)

    @property
    def _began_ns(self) -> int:
        """When the first picture was taken, Unix time."""
        return self._to_unix_ns(self.first_ns + self._least_late_ns)


def recovered(folder: Path) -> list[Path]:
    """Complete the files that a killed program left behind in a folder; their new names. Empty ones are removed."""
    found = []
    for path in sorted(folder.glob(f"{HIDDEN}*Z{SUFFIX}")):
        if path.stat().st_size:
            found.append(path.rename(path.with_name(path.name.removeprefix(HIDDEN))))
        else:
            path.unlink()
    return found
