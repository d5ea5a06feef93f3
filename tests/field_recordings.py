"""Recordings whose frames are stored as two fields, as camcorders' (AVCHD), and those of Dahua's recorders."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.packet import Packet

from tests.foreign_recordings import FPS, picture, write

_LUMA_LEAST, _LUMA_MOST, _GREY = 16, 235, 128


class _Bits:
    """Writes bits as H.264 has them (ITU-T H.264, 7.2 and 9.1)."""

    def __init__(self) -> None:
        self.bits: list[int] = []

    def fixed(self, count: int, value: int) -> _Bits:
        self.bits += [value >> place & 1 for place in range(count - 1, -1, -1)]
        return self

    def unsigned(self, *values: int) -> _Bits:
        for value in values:
            length = (value + 1).bit_length()
            self.fixed(2 * length - 1, value + 1)
        return self

    def align(self) -> _Bits:
        return self.fixed(-len(self.bits) % 8, 0)

    def unit(self, header: int) -> bytes:
        """All of it as a unit behind a start code, with the bytes that keep start codes from appearing by chance."""
        self.fixed(1, 1).align()
        out, zeros = bytearray(), 0
        for byte in np.packbits(np.array(self.bits, np.uint8)).tolist():
            if zeros == 2 and byte <= 3:
                out.append(3)
                zeros = 0
            out.append(byte)
            zeros = zeros + 1 if byte == 0 else 0
        return b"\x00\x00\x00\x01" + bytes([header]) + bytes(out)


def fields(numbers: range, width: int = 320, height: int = 64) -> list[tuple[bytes, bytes]]:
    """Numbered pictures as H.264 that is stored field by field, each picture uncompressed and whole by itself."""
    sequence = _Bits().fixed(8, 77).fixed(8, 0).fixed(8, 30).unsigned(0, 0, 2, 1).fixed(1, 0)
    sequence.unsigned(width // 16 - 1, height // 32 - 1).fixed(4, 0).fixed(1, 1)  # not of frames alone; tells its rate
    sequence.fixed(4, 0).fixed(1, 1).fixed(32, 1).fixed(32, 2 * FPS).fixed(1, 1).fixed(4, 0)
    pictures = _Bits().unsigned(0, 0).fixed(2, 0).unsigned(0, 0, 0).fixed(3, 0).unsigned(0, 0, 0).fixed(3, 0)
    head = sequence.unit(0x67) + pictures.unit(0x68)
    found = []
    for number in numbers:
        luma = np.clip(picture(number, width, height)[:, :, 1], _LUMA_LEAST, _LUMA_MOST)
        found.append((head + _field(luma[0::2], is_first=True), _field(luma[1::2], is_first=False)))
    return found


def _field(luma: np.ndarray, *, is_first: bool) -> bytes:
    bits = _Bits().unsigned(0, 7, 0).fixed(4, 0).fixed(1, 1).fixed(1, not is_first)
    if is_first:
        bits.unsigned(0).fixed(2, 0)
    else:
        bits.fixed(1, 0)
    bits.unsigned(0)
    colour = np.full(128, _GREY, np.uint8)
    for top in range(0, luma.shape[0], 16):
        for left in range(0, luma.shape[1], 16):
            bits.unsigned(25).align()
            block = np.concatenate([luma[top : top + 16, left : left + 16].ravel(), colour])
            bits.bits += np.unpackbits(block).tolist()
    return b"\x00\x00\x00\x01\x09\x10" + bits.unit(0x65 if is_first else 0x61)


def write_fields(path: Path, numbers: range, *, together: bool) -> Path:
    """Such a recording; the fields of a frame in one packet or in two, or without a container where it is ``.h264``."""
    frames = fields(numbers)
    raw = path.with_suffix(".h264")
    raw.write_bytes(b"".join(first + second for first, second in frames))
    if path == raw:
        return path
    with av.open(str(raw)) as opened, av.open(str(path), "w") as output:
        stream = output.add_stream_from_template(opened.streams.video[0])
        for shown, (first, second) in enumerate(frames):
            for part, data in enumerate([first + second] if together else [first, second]):
                packet = Packet(data)
                packet.time_base, packet.stream = Fraction(1, 2 * FPS), stream
                packet.pts = packet.dts = 2 * shown + part
                packet.is_keyframe = part == 0
                output.mux(packet)
    return path


def write_dahua(path: Path, numbers: range) -> Path:
    """A recording as Dahua's recorders export it (``.dav``), which FFmpeg reads and does not write."""
    raw = write(path.with_suffix(".h264"), numbers, container="h264")
    out = bytearray()
    with av.open(str(raw)) as opened:
        for number, packet in enumerate(packet for packet in opened.demux(video=0) if packet.size):
            second, rest = divmod(number, FPS)
            date = second | 10 << 12 | 5 << 17 | 6 << 22 | 24 << 26  # 2024-06-05 10:00, and so many seconds
            further = bytes([0x81, 0, 2, FPS, 0x80, 0, 320 // 8, 240 // 8])  # H.264, its rate; its size
            size = 24 + len(further) + packet.size + 8
            out += b"DHAV" + bytes([0xFD if packet.is_keyframe else 0xFC, 0, 0, 0])
            out += struct.pack("<IIIHBB", number, size, date, round(1000 * rest / FPS), len(further), 0)
            out += further + bytes(packet) + b"dhav" + struct.pack("<I", size)
    path.write_bytes(out)
    return path
