"""Opening an uploaded recording. It is untrusted: local files, known formats, codecs and sizes only."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import av
from av.container import InputContainer
from av.video.stream import VideoStream

from wibam_core.errors import UnreadableVideo

#: Demuxers that may read an upload. Play lists and image sequences, which open other files, are not among them.
FORMATS = ("mov", "mp4", "m4a", "3gp", "3g2", "mj2", "matroska", "webm", "avi", "mpegts", "mpeg", "flv", "asf", "ogg")
#: Decoders that may read an upload, by the name of the decoder.
CODECS = (
    "h264",
    "hevc",
    "mpeg4",
    "mpeg2video",
    "mpeg1video",
    "mjpeg",
    "vp8",
    "vp9",
    "libdav1d",
    "av1",
    "prores",
    "dnxhd",
)
#: Largest frame, px: 8K and some more.
MAX_PIXELS = 40_000_000
#: Colour conversion that rounds: swscale's BILINEAR, FULL_CHR_H_INT and ACCURATE_RND flags.
ACCURATE = 0x2 | 0x2000 | 0x40000

_NS_PER_S = 1_000_000_000
_ATTACHED_PICTURE = av.stream.Disposition.attached_pic


def ns_from_pts(pts: int, time_base: Fraction) -> int:
    """A presentation timestamp in ns, rounded to the nearest, in integers."""
    numerator = pts * time_base.numerator * _NS_PER_S
    return (2 * numerator + time_base.denominator) // (2 * time_base.denominator)


@contextmanager
def open_video(path: Path, threads: int = 1) -> Iterator[tuple[InputContainer, VideoStream]]:
    """Open a recording and its video stream for reading.

    Args:
        path: the file.
        threads: decoding threads.

    Raises:
        UnreadableVideo: saying what the file is instead of a readable video.
    """
    if not path.is_file():
        raise UnreadableVideo(f"{path.name} does not exist or is no file", hint="Give the path of a recording.")
    if path.stat().st_size == 0:
        raise UnreadableVideo(f"{path.name} is an empty file", hint="Upload the recording again.")
    limits = {"protocol_whitelist": "file", "format_whitelist": ",".join(FORMATS), "codec_whitelist": ",".join(CODECS)}
    try:
        # an absolute path begins with no protocol
        container = av.open(str(path.resolve()), "r", container_options=limits, options={"max_pixels": str(MAX_PIXELS)})
    except (av.FFmpegError, OSError, ValueError) as error:
        raise _refusal(path) from error
    with container:
        stream = _video_stream(container, path)
        stream.codec_context.thread_count = max(threads, 1)
        if threads > 1:
            stream.codec_context.thread_type = "AUTO"
        yield container, stream


def _video_stream(container: InputContainer, path: Path) -> VideoStream:
    streams = [s for s in container.streams.video if not s.disposition & _ATTACHED_PICTURE]
    if not streams:
        kinds = ", ".join(sorted({s.type for s in container.streams}))
        raise UnreadableVideo(f"{path.name} has no video stream: it holds {kinds or 'nothing'} only")
    stream = streams[0]
    codec = stream.codec_context
    if codec is None or codec.name not in CODECS:
        name = "an unknown codec" if codec is None else f"the codec {codec.name}"
        raise UnreadableVideo(
            f"{path.name} has video in {name}, which we do not read",
            hint="Re-encode it as H.264 in an MP4 file.",
        )
    if codec.width * codec.height > MAX_PIXELS:
        raise UnreadableVideo(
            f"{path.name} is {codec.width}x{codec.height} px; the largest frame that we read has {MAX_PIXELS:,} px",
            hint="Re-encode it at a smaller size.",
        )
    return stream


def _refusal(path: Path) -> UnreadableVideo:
    """Why a file that did not open did not: MP4 files that were cut off are the common case."""
    with path.open("rb") as file:
        head = file.read(12)
    if head[4:8] == b"ftyp":
        return UnreadableVideo(
            f"{path.name} is an MP4 file that was cut off before its end: its index is missing or broken",
            hint="Copy the file from the camera again; many cameras repair an interrupted recording when switched on.",
        )
    return UnreadableVideo(f"{path.name} is not a video in a format that we read")
