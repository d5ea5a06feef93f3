"""What the packets of one file say: stamps, and by some of its pictures what is shown and how."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.packet import Packet
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from numpy.typing import NDArray

from wibam_core.errors import UnreadableVideo
from wibam_core.video.edits import shown_stretches
from wibam_core.video.h264 import H264Packets
from wibam_core.video.joined import joined_at
from wibam_core.video.picture import Orientation, Orientations, Size
from wibam_core.video.recording import RecordingFile
from wibam_core.video.source import ns_from_pts, open_video, video_streams
from wibam_core.video.stamps import unwrapped_ns
from wibam_core.video.stills import Stills
from wibam_core.video.tags import captured_fps, created_ns, timecode_ns

IntArray = NDArray[np.int64]

#: Stamps beyond this (ns, from zero either way) are damaged: 100 years.
_MAX_TIME_NS = 100 * 365 * 86_400 * 10**9
#: Pictures that are looked at, of a file of many: about so many, so many packets apart at least.
_LOOKED_AT, _LEAST_APART = 40, 50
#: A file that begins between two key frames may lose this much before its first without a word.
_LEAD_IN_NS = 10 * 10**9
#: Counters of MPEG transport and program streams have 33 bits at 90 kHz (ISO/IEC 13818-1).
_MPEG_PERIOD_NS = 2**33 / 90_000 * 1e9
#: Containers with a place in decoding order for each frame, and no stamp that says when it is shown.
_NO_CLOCK = ("h264", "hevc", "m4v", "mpegvideo", "mjpeg")
_BY_DECODING_ORDER = ("avi", *_NO_CLOCK)
#: Containers whose header says when the recording ends, and not how many frames it has.
_SAYING = ("matroska", "flv", "asf")
#: Containers in which a recorder may begin a new track midway, and whose packets fill the file but for a few bytes.
_READ_IN_PART = ("mpegts", "mpeg")
#: After the last packet that is read, and before the first, may lie what so many packets take.
_FEW_PACKETS = 8
#: Sequence headers within a packet: MPEG-1 and 2 (size only), H.264 and H.265 parameter sets behind a start code, and
#: the start of frame of JPEG.
_HEADER = re.compile(
    rb"\x00\x00\x01(?:\xb3...|(?:[\x07\x27\x47\x67]|\x42\x01).+?(?=\x00\x00[\x00\x01]|$))|\xff[\xc0-\xc2].{7}",
    re.DOTALL,
)
_HEADER_WITHIN = 1024


@dataclass(frozen=True)
class Look:
    """How one picture of a file is stored and shown.

    Attributes:
        stored_px: width and height as stored.
        pixel_aspect: width of a stored pixel over its height, when shown.
        aspect_stated: whether the file says that; else it is 1.
        high_range: its brightness is coded for high dynamic range.
    """

    stored_px: Size
    orientation: Orientation
    pixel_aspect: Fraction
    interlaced: bool
    high_range: bool
    aspect_stated: bool = True

    @property
    def upright_px(self) -> Size:
        """Width and height once turned as shown."""
        return self.orientation.size(self.stored_px)

    @property
    def square_px(self) -> Size:
        """Width and height with square pixels, as a player shows it."""
        (width, height), aspect = self.stored_px, self.pixel_aspect
        return self.orientation.size(
            (round(width * aspect), height) if aspect >= 1 else (width, round(height / aspect))
        )


@dataclass(frozen=True, eq=False)
class FilePackets:
    """One file, read once from end to end.

    Attributes:
        numbers: (M,) which packets hold a frame with a stamp, in decoding order; all packets are counted from 0.
        stamps_ns: (M,) their stamps.
        packets: how many packets there are.
        in_order: the stamps tell when frames are decoded: in order, they belong to the frames in the order shown.
        hidden: frames that the file itself says are not to be shown (edit list).
        lead_in, lead_in_ns: (L,) numbers and stamps of frames before the first key frame, which do not decode unless
            the decoder has read what was before; not among ``numbers``.
        unstamped: frames without a (sane) stamp, or that are none of the stream's codec.
        smeared: frames after lost ones, up to the next that is whole by itself.
        unread_share: share of the file's bytes that lie before or behind all that is read, in tracks or recordings of
            their own; 0 where that is not known.
        missing: frames that the file's index names and that are not there.
        stretches: how many of it are shown one after the other (edit list).
        said_ns: when its header says that it ends, on its own clock; None where it does not say, or is not to be asked.
        captured_fps: the rate that its header says the camera took pictures at; None where it does not say.
        has_clock: False where the file knows no times, and the usual rate was assumed.
        looks: what some of its pictures look like, by packet, ascending, where it changes; at least one, if asked for.
        still: packets between which all pictures that were looked at are one and the same; None for none.
        tracks: how many video tracks may be the recording.
        created_ns: when it says that it was made, Unix time.
        timecode_ns: of its first frame, since midnight; None where there is none.
        extradata: what a decoder must know before the first packet.
    """

    file: RecordingFile
    codec: str
    container: str
    tick_ns: float
    numbers: IntArray
    stamps_ns: IntArray
    packets: int
    in_order: bool
    hidden: int
    lead_in: IntArray
    lead_in_ns: IntArray
    unstamped: int
    smeared: int
    unread_share: float
    missing: int
    stretches: int
    said_ns: int | None
    captured_fps: float | None
    has_clock: bool
    looks: dict[int, Look]
    still: tuple[int, int] | None
    tracks: int
    created_ns: int | None
    timecode_ns: int | None
    extradata: bytes = field(repr=False)

    def with_lead_in(self) -> FilePackets:
        """The same, with the frames before the first key frame among all others."""
        numbers, stamps = np.append(self.lead_in, self.numbers), np.append(self.lead_in_ns, self.stamps_ns)
        none = np.empty(0, dtype=np.int64)
        return replace(self, numbers=numbers, stamps_ns=stamps, lead_in=none, lead_in_ns=none)


def numbered(container: InputContainer, stream: VideoStream) -> Iterator[tuple[int, Packet]]:
    """The packets of a stream that hold something, counted, to the end or to where the file is cut off."""
    packets = container.demux(stream)
    number = 0
    while True:
        try:
            packet = next(packets)
        except (StopIteration, av.FFmpegError, EOFError):
            return
        if packet.size:
            yield number, packet
            number += 1


def read_packets(file: RecordingFile, *, look: bool) -> FilePackets:
    """Read all packets of a file.

    Args:
        file: the file.
        look: decode some of its pictures, too.

    Raises:
        UnreadableVideo: not a video, no video stream, an unknown codec, too large a frame, cut off, or no frame that
            can be decoded.
    """
    with open_video(file.path, name=file.name) as (container, stream):
        reader = _Reader(container, stream, look)
        reader.read()
        name = container.format.name.split(",")[0]
        looks = reader.looks if reader.looks or not look else _first_look(file)
        numbers = np.array(reader.numbers, dtype=np.int64)
        stamps = np.array(reader.stamps, dtype=np.int64)
        if name in _NO_CLOCK:
            rate = stream.guessed_rate or stream.average_rate or Fraction(25)
            stamps = np.rint(np.arange(len(numbers)) * (1e9 / float(rate))).astype(np.int64)
        elif name in ("mpegts", "mpeg") and len(stamps):
            stamps = unwrapped_ns(stamps, _MPEG_PERIOD_NS)
        if name == "mov":
            size = file.path.stat().st_size
            missing = sum(entry.pos >= size for entry in stream.index_entries)
            # FFmpeg passes over what an edit list hides, but for what must be decoded to show the rest
            reader.hidden += max(stream.frames - reader.packets - missing, 0)
        elif name == "avi" and len(stamps) and stream.time_base:
            # it counts frames that show once more what was before, too, which have no bytes
            missing = max(stream.frames - 1 - round(stamps.max() / (1e9 * stream.time_base)), 0)
            if (second := joined_at(file.path, name)) is not None:
                later = np.array(reader.places) >= second
                stamps[later] -= stamps[later].min(
                    initial=stamps.max()
                )  # its clock starts anew, as in other containers
        else:
            missing = max(stream.frames - reader.packets, 0)
        return FilePackets(
            file=file,
            codec=stream.codec_context.name,
            container=name,
            tick_ns=1e9 * float(stream.time_base or 0),
            numbers=numbers[reader.lead_in :],
            stamps_ns=stamps[reader.lead_in :],
            packets=reader.packets,
            in_order=name in _BY_DECODING_ORDER,
            hidden=reader.hidden,
            lead_in=numbers[: reader.lead_in],
            lead_in_ns=stamps[: reader.lead_in],
            unstamped=reader.unstamped,
            smeared=reader.smeared,
            unread_share=reader.unread_share(file.path, name),
            missing=missing,
            stretches=shown_stretches(file.path) if name == "mov" else 1,
            said_ns=container.duration * 1000 if name in _SAYING and container.duration else None,
            captured_fps=captured_fps(container, stream),
            has_clock=name not in _NO_CLOCK,
            looks=looks,
            still=reader.stills.longest,
            tracks=len(video_streams(container)),
            created_ns=created_ns(container, stream),
            timecode_ns=timecode_ns(container, stream),
            extradata=bytes(stream.codec_context.extradata or b""),
        )


class _Reader:
    """Goes through the packets of a file once."""

    def __init__(self, container: InputContainer, stream: VideoStream, look: bool) -> None:
        self._container, self._stream, self._look = container, stream, look
        self._no_clock = container.format.name in _NO_CLOCK
        self.numbers: list[int] = []
        self.stamps: list[int] = []
        self.places: list[int] = []
        self.looks: dict[int, Look] = {}
        self.stills = Stills()
        self._orientations = Orientations()
        self.packets = self.hidden = self.lead_in = self.unstamped = self.smeared = 0
        self._first_byte = self._last_byte = 0
        self._is_broken = False
        self._stamps_of_none: list[int | None] = []
        codec = stream.codec_context
        self._h264 = H264Packets(bytes(codec.extradata or b"")) if codec.name == "h264" else None
        expected = stream.frames or int(float(container.duration or 0) / 1e6 * float(stream.average_rate or 25))
        self._apart = max(expected // _LOOKED_AT, _LEAST_APART)

    def read(self) -> None:
        look_at, lead_in = 0, None
        headers: set[bytes] = set()
        for number, packet in numbered(self._container, self._stream):
            self.packets = number + 1
            self._note_place(packet)
            if not self._begins_a_frame(packet):
                continue
            if packet.is_keyframe and lead_in is None:
                lead_in = len(self.numbers)
            if packet.is_discard:
                self.hidden += 1
            elif (time_ns := self._stamp_ns(packet)) is None:
                self.unstamped += 1
            else:
                self.numbers.append(number)
                self.stamps.append(time_ns)
                self.places.append(-1 if packet.pos is None else packet.pos)
            if self._look and packet.is_keyframe and (number >= look_at or _header(packet) not in headers):
                headers.add(_header(packet))
                if self._look_at(number, packet):
                    look_at = number + self._apart
        # what decoders are told beside pictures has the stamps of these
        self.unstamped += len({stamp for stamp in self._stamps_of_none if stamp is not None}.difference(self.stamps))
        # a stream that never has a whole picture is decoded from wherever it begins
        if lead_in and self.stamps[lead_in - 1] - self.stamps[0] <= _LEAD_IN_NS:
            self.lead_in = lead_in

    def unread_share(self, path: Path, container: str) -> float:
        """Share of the file's bytes that lie in recordings or tracks before or behind what was read."""
        size = path.stat().st_size
        if container != "avi" and (end := joined_at(path, container)) is not None:
            return 1.0 - end / size
        if container not in _READ_IN_PART or not self._last_byte:
            return 0.0
        unread = max(self._first_byte, size - self._last_byte)
        return unread / size if unread * self.packets > _FEW_PACKETS * size else 0.0

    def _note_place(self, packet: Packet) -> None:
        if packet.pos is not None and packet.pos >= 0:
            self._first_byte = self._first_byte if self._last_byte else packet.pos
            self._last_byte = max(self._last_byte, packet.pos + packet.size)

    def _begins_a_frame(self, packet: Packet) -> bool:
        """Whether a packet holds a frame, and not only the second field of one or what decoders are told beside them.

        Those that are smeared are counted, and the stamps of what is no picture are kept. A stream without a clock is
        cut into packets at its pictures: there what is told beside one comes with it, and what is alone had one.
        """
        if self._h264 is None:
            self._is_broken = (self._is_broken and not packet.is_keyframe) or packet.is_corrupt
            self.smeared += self._is_broken
            return True
        self._h264.read(bytes(packet), is_key=packet.is_keyframe)
        if not self._h264.is_picture and self._no_clock:
            self.unstamped += 1
        elif not self._h264.is_picture:
            self._stamps_of_none.append(self._stamp_ns(packet))
        elif not self._h264.is_second_field:
            self.smeared += self._h264.is_smeared
            return True
        return False

    def _stamp_ns(self, packet: Packet) -> int | None:
        if self._no_clock:
            return 0
        if packet.pts is None or packet.time_base is None:
            return None
        time_ns = ns_from_pts(packet.pts, packet.time_base)
        return time_ns if abs(time_ns) <= _MAX_TIME_NS else None

    def _look_at(self, number: int, packet: Packet) -> bool:
        codec = self._stream.codec_context
        frames: list[VideoFrame] = []
        with suppress(av.FFmpegError):
            frames += codec.decode(packet)
        with suppress(av.FFmpegError, EOFError):
            frames += codec.decode(None)
        codec.flush_buffers()
        sound = [frame for frame in frames if not frame.is_corrupt]
        if not sound:
            return False
        self.stills.add(number, sound[0])
        look = look_of(sound[0], self._stream, self._orientations)
        if not self.looks or look != next(reversed(self.looks.values())):
            self.looks[number] = look
        return True


def _header(packet: Packet) -> bytes:
    """What a packet says about the size of the pictures from it on, where it says so: the same size, the same bytes."""
    found = _HEADER.search(bytes(memoryview(packet)[:_HEADER_WITHIN]))
    return found[0] if found else b""


def look_of(frame: VideoFrame, stream: VideoStream, orientations: Orientations) -> Look:
    """How a frame is stored and shown; ``orientations`` are those of its file.

    Raises:
        UnreadableVideo: it is shown turned by something else than quarters.
    """
    aspect = stream.sample_aspect_ratio or stream.codec_context.sample_aspect_ratio or Fraction(0)
    return Look(
        (frame.width, frame.height),
        orientations.of(frame),
        Fraction(aspect) if aspect > 0 else Fraction(1),
        bool(frame.interlaced_frame),
        int(frame.color_trc) in (16, 18),  # SMPTE ST 2084, ARIB STD-B67 (ITU-T H.273)
        aspect > 0,
    )


def _first_look(file: RecordingFile) -> dict[int, Look]:
    """Of the first picture that can be decoded, by decoding all before."""
    with open_video(file.path, name=file.name) as (container, stream):
        for number, packet in numbered(container, stream):
            frames: list[VideoFrame] = []
            with suppress(av.FFmpegError):
                frames = stream.decode(packet)
            if frames:
                return {number: look_of(frames[0], stream, Orientations())}
        with suppress(av.FFmpegError, EOFError):
            for frame in stream.decode(None):
                return {0: look_of(frame, stream, Orientations())}
    raise UnreadableVideo(f"{file.name} has a video stream, but not one frame of it can be decoded")
