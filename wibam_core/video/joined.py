"""Files that were joined byte by byte (``cat``, ``copy /b``).

Transport and program streams and Matroska can be joined so: their clock starts anew. AVI is read on as if no time had
passed. Of MP4, FLV and ASF the rest is passed over silently.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

#: Kind, beginning and end of what a box holds (ISO/IEC 14496-12, 4.2).
Box = tuple[bytes, int, int]
#: What files begin with: the header of FLV (Adobe FLV 10.1, E.2: version 1, nine bytes long) without its flags, and the
#: identifier of ASF's header object.
_FLV, _FLV_LENGTH = b"FLV\x01", b"\x00\x00\x00\x09"
_ASF = bytes.fromhex("3026b2758e66cf11a6d900aa0062ce6c")


def joined_at(path: Path, container: str) -> int | None:
    """Where in an MP4, AVI, FLV or ASF file a second recording begins; None: nowhere, or another container.

    Args:
        path: the file.
        container: FFmpeg's short name.
    """
    try:
        with path.open("rb") as file:
            if container == "mov":
                return _second_mp4(file, path.stat().st_size)
            if container == "avi":
                return _second_avi(file, path.stat().st_size)
            if container in ("flv", "asf"):
                with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                    return _second_flv(content) if container == "flv" else _none_if_negative(content.find(_ASF, 1))
    except (OSError, ValueError, struct.error):
        return None
    return None


def top_level(file: BinaryIO, size: int) -> Iterator[Box]:
    """Kind, beginning and end of what each box of an MP4 or MOV file holds."""
    at = 0
    while at + 8 <= size:
        file.seek(at)
        head = file.read(16)
        length, kind = struct.unpack(">I4s", head[:8])
        start = 8
        if length == 1:
            length, start = struct.unpack(">Q", head[8:16])[0], 16
        length = length or size - at
        if length < start:
            return
        yield kind, at + start, at + length
        at += length


def _second_mp4(file: BinaryIO, size: int) -> int | None:
    begun = False
    for kind, start, _ in top_level(file, size):
        if kind == b"ftyp" and begun:
            return start - 8
        begun = begun or kind in (b"moov", b"mdat")
    return None


def _second_avi(file: BinaryIO, size: int) -> int | None:
    """A recording of more than a gigabyte goes on in further lists of its own, ``AVIX`` (OpenDML 1.02)."""
    at = 0
    while at + 12 <= size:
        file.seek(at)
        kind, length, form = struct.unpack("<4sI4s", file.read(12))
        if at and kind == b"RIFF" and form == b"AVI ":
            return at
        at += 8 + length + length % 2
    return None


def _second_flv(content: mmap.mmap) -> int | None:
    at = content.find(_FLV, 1)
    while at >= 0 and content[at + 5 : at + 9] != _FLV_LENGTH:
        at = content.find(_FLV, at + 1)
    return _none_if_negative(at)


def _none_if_negative(at: int) -> int | None:
    return at if at >= 0 else None
