"""How long a recording is, as its header says: quick to read, and good enough to say how long work on it takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import av

from wibam_core.errors import UnreadableVideo
from wibam_core.video.source import open_video

#: Fewer bytes a second hold no video: a header that says so is wrong.
_LEAST_BYTES_S = 100.0


@dataclass(frozen=True)
class SaidLength:
    """What a header says: seconds, and frames in them."""

    seconds: float
    frames: int


def said_length(path: Path) -> SaidLength | None:
    """What the header of a recording says; None where it says nothing, or the file cannot be read."""
    try:
        with open_video(path) as (container, stream):
            if stream.duration is not None and stream.time_base is not None:
                seconds = float(stream.duration * stream.time_base)
            else:
                seconds = (container.duration or 0) / av.time_base
            rate = float(stream.average_rate or stream.guessed_rate or 0)
    except UnreadableVideo:
        return None
    if not (seconds > 0 and rate > 0) or path.stat().st_size < _LEAST_BYTES_S * seconds:
        return None
    return SaidLength(seconds, stream.frames or round(seconds * rate))
