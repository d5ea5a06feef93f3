"""What a recording is, measured from its packets rather than believed from its header."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from numpy.typing import NDArray

from wibam_core.documents.recordings import VideoInfo
from wibam_core.errors import UnreadableVideo
from wibam_core.video.source import ns_from_pts, open_video

#: Intervals that differ from the usual one by more than this share make a frame rate variable.
_RATE_TOLERANCE = 0.1
#: A recording whose timestamps span more has wrong timestamps.
_MAX_HOURS = 48
#: Timestamps beyond this (ns, from zero either way) are damaged: 100 years.
_MAX_TIME_NS = 100 * 365 * 86_400 * 10**9


def probe(path: Path) -> VideoInfo:
    """Measure a recording: as `measure`, without the times."""
    return measure(path)[0]


def measure(path: Path) -> tuple[VideoInfo, NDArray[np.int64]]:
    """Measure a recording: reads all of it, decodes one frame.

    Returns:
        What it is, and the presentation times (N,) in ns of all its frames, ascending. Not all of them need decode.

    Raises:
        UnreadableVideo: not a video, no video stream, an unknown codec, too large a frame, cut off, or no frame
            that can be decoded.
    """
    with open_video(path) as (container, stream):
        codec = stream.codec_context.name
        container_name = container.format.name.split(",")[0]
        declared = stream.frames
        first = _first_frame(container, stream, path)
        tick_ns = 1e9 * float(stream.time_base or 0)
    # a fresh container: seeking back is what formats without an index do badly
    with open_video(path) as (container, stream):
        times_ns = _packet_times_ns(container, stream)
    if len(times_ns) < 2:
        raise UnreadableVideo(f"{path.name} holds {len(times_ns)} frames with a timestamp: that is no recording")
    hours = float(times_ns[-1] - times_ns[0]) / 3.6e12
    if hours > _MAX_HOURS:
        raise UnreadableVideo(f"the timestamps of {path.name} span {hours:.0f} hours: they are damaged")
    intervals_ns = np.diff(times_ns)
    usual_ns = _usual_interval_ns(intervals_ns)
    rotation = int(first.rotation) % 360
    width, height = (first.width, first.height) if rotation % 180 == 0 else (first.height, first.width)
    info = VideoInfo(
        codec=codec,
        container=container_name,
        width_px=width,
        height_px=height,
        rotation_deg=rotation,
        fps=1e9 / usual_ns,
        frames=len(times_ns),
        missing_frames=max(declared - len(times_ns), 0),
        first_ns=int(times_ns[0]),
        last_ns=int(times_ns[-1]),
        duration_s=float(times_ns[-1] - times_ns[0] + usual_ns) / 1e9,
        largest_gap_s=float(intervals_ns.max()) / 1e9,
        variable_rate=bool((np.abs(intervals_ns - usual_ns) > _RATE_TOLERANCE * usual_ns + tick_ns).any()),
    )
    return info, times_ns


def _first_frame(container: InputContainer, stream: VideoStream, path: Path) -> VideoFrame:
    try:
        for packet in container.demux(stream):
            try:
                frames = stream.decode(packet)
            except av.FFmpegError:
                continue
            if frames:
                return frames[0]
    except (av.FFmpegError, EOFError):
        pass
    raise UnreadableVideo(f"{path.name} has a video stream, but not one frame of it can be decoded")


def _packet_times_ns(container: InputContainer, stream: VideoStream) -> NDArray[np.int64]:
    """Presentation times of all packets, ascending, each once. Packets come in decoding order."""
    times: list[int] = []
    try:
        for packet in container.demux(stream):
            if packet.pts is None or not packet.size or packet.is_discard:
                continue
            time_ns = ns_from_pts(packet.pts, packet.time_base)
            if abs(time_ns) <= _MAX_TIME_NS:
                times.append(time_ns)
    except (av.FFmpegError, EOFError):
        pass  # cut off here: what came before is counted
    return np.unique(np.asarray(times, dtype=np.int64))


def _usual_interval_ns(intervals_ns: NDArray[np.int64]) -> float:
    """Mean of the intervals that are no gaps: exact where the container rounds its timestamps."""
    median = float(np.median(intervals_ns))
    return float(intervals_ns[intervals_ns < 1.5 * median].mean())
