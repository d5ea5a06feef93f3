"""What containers note beside the pictures: when a file was made, its timecode, how often pictures were taken."""

from __future__ import annotations

import re
from contextlib import suppress
from datetime import UTC, datetime
from fractions import Fraction

import numpy as np
from av.container import InputContainer
from av.video.stream import VideoStream

_TIMECODE = re.compile(r"(\d{2}):(\d{2}):(\d{2})([:;.])(\d{2})")


def created_ns(container: InputContainer, stream: VideoStream) -> int | None:
    """When a file says that it was made, Unix time; None where it does not say."""
    for metadata in (stream.metadata, container.metadata):
        with suppress(ValueError):
            time = datetime.fromisoformat(metadata.get("creation_time", ""))
            time = time if time.tzinfo else time.replace(tzinfo=UTC)
            if time.year > 1980:  # 1904 and 1970 are clocks that were never set
                return round(time.timestamp() * 1e6) * 1000
    return None


def captured_fps(container: InputContainer, stream: VideoStream) -> float | None:
    """What Android's cameras write: of slow motion another rate than that of the stamps."""
    said = {key.lower(): value for key, value in (*container.metadata.items(), *stream.metadata.items())}
    with suppress(ValueError):
        rate = float(said.get("com.android.capture.fps", "nan"))
        return rate if np.isfinite(rate) and rate > 0 else None
    return None


def timecode_ns(container: InputContainer, stream: VideoStream) -> int | None:
    """Of the timecode track (``tmcd``): hours, minutes, seconds and frames, counted at the whole rate.

    At 29.97 frames a second a counter without dropped numbers runs slow, so that frames are counted, not seconds;
    one with them (";") leaves out two numbers a minute, but every tenth (SMPTE ST 12-1).
    """
    every = [stream.metadata, container.metadata, *(other.metadata for other in container.streams)]
    found = next((match for m in every if (match := _TIMECODE.fullmatch(m.get("timecode", "")))), None)
    rate = stream.average_rate or stream.guessed_rate
    if found is None or not rate:
        return None
    hours, minutes, seconds, frames = (int(found[group]) for group in (1, 2, 3, 5))
    whole = round(rate)
    minutes += 60 * hours
    count = (60 * minutes + seconds) * whole + frames
    if found[4] != ":":
        count -= round(whole / 15) * (minutes - minutes // 10)
    return round(count / Fraction(rate) * 1_000_000_000)
