"""The edit list of an MP4 or MOV file (ISO/IEC 14496-12, 8.6.6): which stretches of the file are shown.

A lead-in that is hidden is one stretch, and usual. Several are an edited recording: the time between them is cut out,
and no stamp says so. FFmpeg follows edit lists without telling of them.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from wibam_core.video.joined import Box, top_level

#: Indices of the longest recordings are smaller.
_MAX_INDEX = 1 << 28
_MAX_EDITS = 10_000


def shown_stretches(path: Path) -> int:
    """How many stretches of a video track are shown one after the other: the most that a track has; 1 without a list.

    Broken files are taken for unedited: opening them says what is wrong.
    """
    try:
        index = _index(path)
        tracks = [_edits(index, *body) for kind, *body in _boxes(index, 0, len(index)) if kind == b"trak"]
    except (OSError, struct.error, ValueError):
        return 1
    return max([1, *tracks])


def _index(path: Path) -> bytes:
    """What the file's ``moov`` box holds; nothing where there is none."""
    with path.open("rb") as file:
        for kind, start, end in top_level(file, path.stat().st_size):
            if kind == b"moov":
                file.seek(start)
                return file.read(min(end - start, _MAX_INDEX))
    return b""


def _boxes(data: bytes, start: int, end: int) -> Iterator[Box]:
    """Kind, beginning and end of what each box between two places holds."""
    while start + 8 <= end:
        length, kind = struct.unpack(">I4s", data[start : start + 8])
        if not 8 <= length <= end - start:
            return
        yield kind, start + 8, start + length
        start += length


def _edits(data: bytes, start: int, end: int) -> int:
    """Stretches of media that a track shows; 0 of one that is no video."""
    is_video, edits = False, 0
    for kind, inside, until in _boxes(data, start, end):
        if kind == b"mdia":
            kinds = [data[at + 8 : at + 12] for name, at, _ in _boxes(data, inside, until) if name == b"hdlr"]
            is_video = b"vide" in kinds
        elif kind == b"edts":
            edits = sum(_stretches(data, at, to) for name, at, to in _boxes(data, inside, until) if name == b"elst")
    return edits if is_video else 0


def _stretches(data: bytes, start: int, end: int) -> int:
    """Entries of an edit list that show something of the media; 0 of one that is too short to have any."""
    if end - start < 8:
        return 0
    version, count = data[start], struct.unpack(">I", data[start + 4 : start + 8])[0]
    form = struct.Struct(">QqI" if version == 1 else ">IiI")
    entries = min(count, _MAX_EDITS, (end - start - 8) // form.size)
    return sum(form.unpack_from(data, start + 8 + k * form.size)[1] >= 0 for k in range(entries))
