"""A camera's stream over RTSP (RFC 2326, 7826), read packet by packet: connecting, signing in, and what goes wrong.

Pictures and control share one TCP connection, so that nothing is lost between the camera and here but by a broken
connection. Addresses hold passwords, which some makers' cameras want in the path: no message, log or file has more of
one than the host.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import av
from av.packet import Packet
from av.video.stream import VideoStream

from wibam_core.errors import InputError, ServiceUnavailable
from wibam_core.video.source import CODECS, MAX_PIXELS

#: A stream that is silent for so long is gone, s.
SILENCE_S = 10.0
_SCHEMES = ("rtsp", "rtsps")


class StreamLost(ServiceUnavailable):
    """A stream that may come back: nobody answers, or the connection broke."""


class StreamRefused(InputError):
    """A stream that does not become readable by waiting: no such stream, another password, no video."""


@dataclass(frozen=True)
class StreamAddress:
    """Where a camera's stream is.

    Attributes:
        url: with name and password, if it takes any: not for people to see.
    """

    url: str = field(repr=False)

    @classmethod
    def of(cls, text: str) -> StreamAddress:
        """The address in a text.

        Raises:
            InputError: it is none. The message does not repeat the text.
        """
        try:
            parts = urlsplit(text)
            good = parts.scheme.lower() in _SCHEMES and parts.hostname and (parts.port is None or parts.port > 0)
            # a / ? or # within a password ends the host there, and the password would be taken for a path
            good = good and "@" not in parts.path + parts.query + parts.fragment
        except ValueError:
            good = False
        if not good or any(not character.isprintable() or character == " " for character in text):
            raise InputError(
                "the address of a stream is not of the form rtsp://NAME:PASSWORD@HOST:PORT/PATH",
                hint="Write @, /, :, ? and # in a name or password as %40, %2F, %3A, %3F and %23; @ in a path, too.",
            )
        return cls(text)

    def __str__(self) -> str:
        """The host alone: paths and queries of cameras' addresses may hold passwords, too."""
        parts = urlsplit(self.url)
        return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}"


@dataclass(frozen=True, eq=False)
class Arrived:
    """A packet and when it arrived, on a clock that is never set."""

    packet: Packet
    stream: VideoStream
    arrived_ns: int


@contextmanager
def open_stream(address: StreamAddress, silence_s: float = SILENCE_S) -> Iterator[Iterator[Arrived]]:
    """Connect, and read packets as they come.

    Raises:
        StreamRefused: no such stream, wrong name or password, no video, or video that we do not read.
        StreamLost: nobody answers; while reading, the connection broke, the stream ended, or was silent for too long.
    """
    options = {
        "rtsp_transport": "tcp",
        "allowed_media_types": "video",
        "timeout": str(round(silence_s * 1e6)),
        "max_pixels": str(MAX_PIXELS),
    }
    with _named(address):
        container = av.open(
            address.url,
            "r",
            format="rtsp",
            options=options,
            container_options=options,
            metadata_errors="replace",  # cameras name their streams in any encoding
            timeout=silence_s,
        )
    with container:
        yield _packets(container.demux(_video_of(container.streams.video, address)), address)


def _packets(packets: Iterator[Packet], address: StreamAddress) -> Iterator[Arrived]:
    with _named(address):
        for number, packet in enumerate(packets):
            if isinstance(packet.stream, VideoStream):
                if number == 0 and packet.pts is None:
                    packet.pts = 0  # FFmpeg counts from the first picture, and leaves that itself without a stamp
                yield Arrived(packet, packet.stream, time.monotonic_ns())
    raise StreamLost(f"{address} has ended", hint="It is tried again.")


def _video_of(streams: tuple[VideoStream, ...], address: StreamAddress) -> VideoStream:
    """Of several videos the largest, which cameras list in any order."""
    if not streams:
        raise StreamRefused(f"{address} has no video", hint="Give the address of the camera's video stream.")
    known = [one for one in streams if one.codec_context is not None and one.codec_context.name in CODECS]
    if not known:
        names = ", ".join(sorted({one.codec_context.name if one.codec_context else "unknown" for one in streams}))
        raise StreamRefused(
            f"{address} has video in a codec that we do not read ({names})",
            hint="Set the camera to H.264 or H.265.",
        )
    return max(known, key=lambda one: one.codec_context.width * one.codec_context.height)


@contextmanager
def _named(address: StreamAddress) -> Iterator[None]:
    """Errors of FFmpeg, which hold the address as it is, as ours, which do not."""
    refused: StreamRefused | StreamLost
    try:
        yield
    except av.HTTPUnauthorizedError:
        refused = StreamRefused(
            f"{address} does not take this name and password",
            hint="Write them into the address: rtsp://NAME:PASSWORD@HOST/PATH, with %40 for @ and the like.",
        )
    except av.HTTPForbiddenError:
        refused = StreamRefused(f"{address} is not for this user", hint="Allow it in the camera's settings.")
    except av.HTTPNotFoundError:
        refused = StreamRefused(f"{address}: the camera has no such stream", hint="Look its path up in its manual.")
    except (av.FFmpegError, OSError, ValueError) as error:
        refused = StreamLost(
            f"{address} cannot be read: {_said(error)}", hint="Is the camera on, and can it be reached from here?"
        )
    else:
        return
    raise refused from None


def _said(error: Exception) -> str:
    said = getattr(error, "strerror", None) or type(error).__name__
    return "no answer for too long" if isinstance(error, av.ExitError | TimeoutError) else str(said).lower()
