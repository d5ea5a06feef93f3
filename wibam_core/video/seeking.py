"""Parts of a recording, without reading all that lies before them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import av

from wibam_core.errors import UnreadableVideo
from wibam_core.video.picture import Image, Orientation, Orientations, to_bgr
from wibam_core.video.source import ns_from_pts, open_video

_NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class Header:
    """What a recording's header says of it. A file that was cut off is shorter than that.

    Attributes:
        duration_s: 0 where the header does not say.
        fps: 0 where the header does not say.
        width_px, height_px: as shown, so after rotation.
    """

    duration_s: float
    fps: float
    width_px: int
    height_px: int


def read_header(path: Path) -> Header:
    """Raises:
    UnreadableVideo: the file cannot be opened, or has no frame.
    """
    with open_video(path) as (container, stream):
        for frame in _decoded(container, stream):
            width, height = Orientation.of(frame).size((frame.width, frame.height))
            duration_s = float(container.duration or 0) / av.time_base
            return Header(duration_s, float(stream.average_rate or 0), width, height)
    raise UnreadableVideo(f"{path.name} has no frame that can be decoded", hint="Upload the recording again.")


def frames_from(path: Path, start_ns: int, *, width_px: int | None = None) -> Iterator[tuple[int, Image]]:
    """Frames from the last one that begins at or before a time, each with its presentation time in ns.

    Args:
        path: the file.
        start_ns: on the recording's own clock. Before its first frame: from there.
        width_px: as in `wibam_core.video.decode.decode`.

    Raises:
        UnreadableVideo: the file cannot be opened.
    """
    with open_video(path) as (container, stream):
        if start_ns > 0 and stream.time_base is not None:
            try:
                container.seek(int(start_ns / _NS_PER_S / stream.time_base), stream=stream)
            except av.FFmpegError:
                container.seek(0)  # a file without an index is read from its beginning
        orientations = Orientations()

        def shown(frame: av.VideoFrame) -> Image:
            return to_bgr(frame, orientations.of(frame), None, width_px)

        before: tuple[int, av.VideoFrame] | None = None
        for frame in _decoded(container, stream):
            if frame.pts is None or frame.time_base is None:
                continue
            time_ns = ns_from_pts(frame.pts, frame.time_base)
            if time_ns < start_ns:
                before = time_ns, frame
                continue
            if before is not None and time_ns > start_ns:
                yield before[0], shown(before[1])
            before = None
            yield time_ns, shown(frame)
        if before is not None:
            yield before[0], shown(before[1])


def _decoded(container: av.container.InputContainer, stream: av.video.stream.VideoStream) -> Iterator[av.VideoFrame]:
    """Whatever can be decoded, up to where the file is damaged."""
    try:
        yield from container.decode(stream)
    except av.FFmpegError:
        return
