"""Recordings as strangers bring them: any container and codec, joined, cut and damaged on the level of packets."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.packet import Packet
from numpy.typing import NDArray

FPS = 24
WIDTH, HEIGHT = 320, 240
_FIRST_PX, _STEP_PX = 10, 4
_TS_PACKET = 188


def picture(number: int, width: int = WIDTH, height: int = HEIGHT) -> NDArray[np.uint8]:
    """A picture with its number in it: how wide its bright part is."""
    image = np.full((height, width, 3), 40, np.uint8)
    image[:, : round((_FIRST_PX + _STEP_PX * number) * width / WIDTH)] = 200
    return image


def number_of(image: NDArray[np.uint8]) -> int:
    """The number that is seen in a picture, whatever its size."""
    bright = float((image[image.shape[0] // 2, :, 1] > 120).mean())
    return round((bright * WIDTH - _FIRST_PX) / _STEP_PX)


def write(
    path: Path,
    numbers: range = range(48),
    *,
    codec: str = "libx264",
    container: str | None = None,
    b_frames: int = 0,
    key_every: int = 24,
    rate: int = FPS,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    pixels: str = "yuv420p",
    options: Mapping[str, str] | None = None,
    metadata: Mapping[str, str] | None = None,
    prepare: Callable[[av.video.stream.VideoStream], None] = lambda stream: None,
) -> Path:
    """A recording of numbered pictures, ``rate`` a second, the first one at 0."""
    with av.open(str(path), "w", format=container) as output:
        chosen = {"bf": str(b_frames), "g": str(key_every)}
        if codec == "libx264":
            chosen |= {"preset": "ultrafast", "b-adapt": "0", "crf": "18"}
        stream = output.add_stream(codec, rate=rate, options=chosen | dict(options or {}))
        stream.width, stream.height, stream.pix_fmt = *size, pixels
        stream.codec_context.thread_count = 1
        output.metadata.update(metadata or {})
        prepare(stream)
        for shown, number in enumerate(numbers):
            frame = av.VideoFrame.from_ndarray(picture(number, *size), format="bgr24")
            frame.pts, frame.time_base = shown, Fraction(1, rate)
            output.mux(stream.encode(frame))
        output.mux(stream.encode(None))
    return path


def copy(
    source: Path,
    path: Path,
    *,
    shift_s: float = 0.0,
    keep: Callable[[int, Packet], bool] = lambda number, packet: True,
    metadata: Mapping[str, str] | None = None,
    **options: str,
) -> Path:
    """The packets of a recording in another file, moved in time; without decoding, as cameras and people cut them."""
    with av.open(str(source)) as opened, av.open(str(path), "w", options=options) as output:
        stream = output.add_stream_from_template(opened.streams.video[0])
        output.metadata.update(metadata or {})
        packets = (packet for packet in opened.demux(opened.streams.video[0]) if packet.size)
        for number, packet in enumerate(packets):
            if keep(number, packet):
                shift = round(shift_s / float(packet.time_base))
                packet.pts += shift
                packet.dts = (packet.pts if packet.dts is None else packet.dts + shift) or 0
                packet.stream = stream
                output.mux(packet)
    return path


def restamp_ts(path: Path, frame: int, jump_s: float) -> None:
    """Stamp one frame of an MPEG transport stream another time (ISO/IEC 13818-1, 2.4.3.7)."""
    data = bytearray(path.read_bytes())
    seen = -1
    for at in range(0, len(data), _TS_PACKET):
        if not data[at + 1] & 0x40:
            continue
        start = at + 4 + (1 + data[at + 4] if data[at + 3] & 0x20 else 0)
        if data[start : start + 3] != b"\0\0\1" or data[start + 3] != 0xE0:
            continue
        seen += 1
        if seen != frame:
            continue
        for field in (9, 14) if data[start + 7] >> 6 == 3 else (9,):
            stamp = data[start + field : start + field + 5]
            ticks = (stamp[0] >> 1 & 7) << 30 | stamp[1] << 22 | (stamp[2] >> 1) << 15 | stamp[3] << 7 | stamp[4] >> 1
            ticks += round(jump_s * 90_000)
            data[start + field : start + field + 5] = bytes(
                [
                    stamp[0] & 0xF0 | (ticks >> 30 & 7) << 1 | 1,
                    ticks >> 22 & 255,
                    (ticks >> 15 & 127) << 1 | 1,
                    ticks >> 7 & 255,
                    (ticks & 127) << 1 | 1,
                ]
            )
    path.write_bytes(data)


def edit_mp4(path: Path, *stretches: tuple[float, float]) -> None:
    """Let an MP4 whose index is at its end show stretches of its media: seconds that each lasts, and where it begins.

    ISO/IEC 14496-12: 8.1 boxes, 8.2.2 ``mvhd``, 8.4.2 ``mdhd``, 8.6.6 ``elst``.
    """
    data = bytearray(path.read_bytes())
    moov, mvhd, trak, edts, mdhd = (data.index(kind) - 4 for kind in (b"moov", b"mvhd", b"trak", b"edts", b"mdhd"))
    movie, media = (struct.unpack_from(">I", data, at + 20)[0] for at in (mvhd, mdhd))
    entries = b"".join(
        struct.pack(">IiI", round(lasts * movie), round(begins * media), 1 << 16) for lasts, begins in stretches
    )
    elst = struct.pack(">I4sII", 16 + len(entries), b"elst", 0, len(stretches)) + entries
    old = struct.unpack_from(">I", data, edts)[0]
    data[edts : edts + old] = struct.pack(">I4s", 8 + len(elst), b"edts") + elst
    for box in (moov, trak):
        struct.pack_into(">I", data, box, struct.unpack_from(">I", data, box)[0] + 8 + len(elst) - old)
    path.write_bytes(data)
