"""Opening an uploaded recording. It is untrusted: local files, known formats, codecs and sizes only."""

from __future__ import annotations

import codecs
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import av
from av.container import InputContainer
from av.video.stream import VideoStream

from wibam_core.errors import UnreadableVideo

#: Demuxers that may read an upload. Play lists and image sequences, which open other files, are not among them.
FORMATS = (
    *("mov", "mp4", "m4a", "3gp", "3g2", "mj2", "matroska", "webm", "avi", "mpegts", "mpeg", "flv", "asf", "ogg"),
    *("h264", "hevc", "mjpeg", "mpegvideo", "m4v", "dhav", "mxf", "dv", "ivf"),
)
#: Decoders that may read an upload, by the name of the decoder.
CODECS = (
    *("h264", "hevc", "libdav1d", "av1", "vp8", "vp9", "mpeg4", "mpeg2video", "mpeg1video", "mjpeg"),
    *("prores", "dnxhd", "cfhd", "dvvideo", "wmv1", "wmv2", "wmv3", "vc1", "msmpeg4v1", "msmpeg4v2", "msmpeg4"),
    *("h263", "flv", "theora", "ffv1", "huffyuv", "ffvhuff", "utvideo", "magicyuv", "rawvideo"),
)
#: Largest frame, px: 8K and some more.
MAX_PIXELS = 40_000_000
#: Colour conversion that rounds: swscale's BILINEAR, FULL_CHR_H_INT and ACCURATE_RND flags.
ACCURATE = 0x2 | 0x2000 | 0x40000
#: The same that shrinks by area: AREA instead of BILINEAR.
ACCURATE_BY_AREA = 0x20 | 0x2000 | 0x40000

_NS_PER_S = 1_000_000_000
#: So much of a file shows what it is instead of a video.
_HEAD = 4096
_UNPACK = "Unpack it and upload the recording in it."
_NO_PICTURES = "Make one video file of the pictures, with the time of each."
_WHERE = "Get the recording again from where it came, and look whether it plays."
_PIECE = "a piece from the middle of an MP4 stream, without its beginning"
_JOIN = "Put the stream's first piece (often called init) and all others in order into one file."
_NO_RECORDING = (
    av.stream.Disposition.attached_pic | av.stream.Disposition.timed_thumbnails | av.stream.Disposition.still_image
)


def ns_from_pts(pts: int, time_base: Fraction) -> int:
    """A presentation timestamp in ns, rounded to the nearest, in integers."""
    numerator = pts * time_base.numerator * _NS_PER_S
    return (2 * numerator + time_base.denominator) // (2 * time_base.denominator)


@contextmanager
def open_video(path: Path, threads: int = 1, name: str | None = None) -> Iterator[tuple[InputContainer, VideoStream]]:
    """Open a recording and its video stream for reading.

    Args:
        path: the file.
        threads: decoding threads.
        name: what messages call it; None: its name on the disk.

    Raises:
        UnreadableVideo: saying what the file is instead of a readable video.
    """
    name = name or path.name
    with open_container(path, name) as container:
        stream = _video_stream(container, name)
        stream.codec_context.thread_count = max(threads, 1)
        if threads > 1:
            stream.codec_context.thread_type = "AUTO"
        yield container, stream


@contextmanager
def open_container(path: Path, name: str, allowed: Sequence[str] = CODECS) -> Iterator[InputContainer]:
    """Open a recording for reading.

    Args:
        path: the file.
        name: what messages call it.
        allowed: decoders that may be used.

    Raises:
        UnreadableVideo: saying what the file is instead of a readable video.
    """
    if not path.is_file():
        raise UnreadableVideo(f"{name} does not exist or is no file", hint="Give the path of a recording.")
    if path.stat().st_size == 0:
        raise UnreadableVideo(f"{name} is an empty file", hint="Upload the recording again.")
    limits = {
        "protocol_whitelist": "file",
        "format_whitelist": ",".join(FORMATS),
        "codec_whitelist": ",".join(allowed),
    }
    try:
        # an absolute path begins with no protocol
        container = av.open(str(path.resolve()), "r", container_options=limits, options={"max_pixels": str(MAX_PIXELS)})
    except (av.FFmpegError, OSError, ValueError) as error:
        raise _refusal(path, name) from error
    with container:
        yield container


def video_streams(container: InputContainer) -> list[VideoStream]:
    """The video tracks that may be the recording, the likeliest first: no cover pictures, thumbnails or stills.

    Among several it is, as in players, one that the file marks as its default, else the one with the largest picture.
    """
    streams = [
        stream
        for stream in container.streams.video
        if not stream.disposition & _NO_RECORDING and stream.codec_context is not None
    ]
    moving = [stream for stream in streams if stream.frames != 1] or streams
    readable = [stream for stream in moving if stream.codec_context.name in CODECS] or moving

    def rank(stream: VideoStream) -> tuple[bool, int, int]:
        default = bool(stream.disposition & av.stream.Disposition.default)
        return (not default, -stream.codec_context.width * stream.codec_context.height, stream.index)

    return sorted(readable, key=rank)


def _video_stream(container: InputContainer, name: str) -> VideoStream:
    streams = video_streams(container)
    if not streams:
        kinds = ", ".join(sorted({s.type for s in container.streams}))
        if container.streams.video:
            kinds = "pictures" if kinds == "video" else f"pictures, {kinds}"
        raise UnreadableVideo(f"{name} has no video stream: it holds {kinds or 'nothing'} only")
    stream = streams[0]
    codec = stream.codec_context
    if codec.name not in CODECS:
        raise UnreadableVideo(
            f"{name} has video in the codec {codec.name}, which we do not read",
            hint="Re-encode it as H.264 in an MP4 file.",
        )
    if codec.width * codec.height > MAX_PIXELS:
        raise UnreadableVideo(
            f"{name} is {codec.width}x{codec.height} px; the largest frame that we read has {MAX_PIXELS:,} px",
            hint="Re-encode it at a smaller size.",
        )
    return stream


#: What other files begin with: bytes, from which place on, and what the file is.
_OTHERS = (
    (0, b"PK\x03\x04", "a ZIP archive", _UNPACK),
    (0, b"Rar!", "a RAR archive", _UNPACK),
    (0, b"7z\xbc\xaf", "a 7z archive", _UNPACK),
    (0, b"\x1f\x8b", "a compressed file (gzip)", _UNPACK),
    (0, b"\xff\xd8\xff", "a single picture (JPEG)", _NO_PICTURES),
    (0, b"\x89PNG", "a single picture (PNG)", _NO_PICTURES),
    (0, b"GIF8", "a GIF", _NO_PICTURES),
    (0, b"%PDF", "a PDF document", _WHERE),
    (0, b"#EXTM3U", "a play list, which only names recordings", "Upload the files that it names, in order."),
    (0, b"version https://git-lfs", "a pointer of Git LFS, not the file itself", "Fetch the file with `git lfs pull`."),
    (8, b"WAVE", "sound without pictures (WAV)", _WHERE),
    (0, b"ID3", "sound without pictures (MP3)", _WHERE),
    (4, b"styp", _PIECE, _JOIN),
    (4, b"moof", _PIECE, _JOIN),
    (4, b"sidx", _PIECE, _JOIN),
)


def _refusal(path: Path, name: str) -> UnreadableVideo:
    """Why a file that did not open did not: MP4 files that were cut off are the common case."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if head[4:8] == b"ftyp":
        return UnreadableVideo(
            f"{name} is an MP4 file that was cut off before its end: its index is missing or broken",
            hint="Copy the file from the camera again; many cameras repair an interrupted recording when switched on.",
        )
    for at, signature, what, hint in _OTHERS:
        if head[at:].startswith(signature):
            return UnreadableVideo(
                f"{name} is no video but {what}" if what != _PIECE else f"{name} is {what}", hint=hint
            )
    if head.lstrip()[:1] in (b"<", b"{") or head.lstrip(codecs.BOM_UTF8).lstrip()[:1] == b"<":
        return UnreadableVideo(
            f"{name} is no video but a text, such as what a server answers to a failed download", hint=_WHERE
        )
    if head and not head.strip(b"\0"):
        return UnreadableVideo(
            f"{name} begins with zeros alone: it was never written, or its card is damaged",
            hint="Copy the file from the camera again; if it is the same there, try to repair the card.",
        )
    return UnreadableVideo(f"{name} is not a video in a format that we read")
