"""Writing H.264 recordings with exact timestamps."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import cv2
import numpy as np
from av.video.frame import VideoFrame
from numpy.typing import NDArray

from wibam_core.video.source import ACCURATE

#: Ticks per second of our recordings; timestamps are exact within half a tick (5.6 µs).
TICKS_PER_S = 90_000
_NS_PER_S = 1_000_000_000
#: Longest interval between frames: 6.6 hours.
_MAX_GAP = 2**31 - 1
#: AVColorSpace SMPTE 170M, which has the matrix of BT.601, and AVColorRange "MPEG" (16–235).
_BT601, _LIMITED_RANGE = 6, 1


def ticks_from_ns(time_ns: int) -> int:
    """The nearest tick, in integers: no rounding of floats however late the time."""
    return (time_ns * TICKS_PER_S + _NS_PER_S // 2) // _NS_PER_S


class VideoWriter:
    """An H.264 recording in an MP4 file, written frame by frame.

    Frame intervals may vary: a dropped frame is a gap in the timestamps. The first timestamp is kept. The same
    frames give the same bytes: one encoding thread, no creation time, and none of x264's macroblock tree, whose result
    depends on what lies in memory beside its buffers (one encoding in ten differed).

    Args:
        path: the file; replaced if it exists.
        width_px, height_px: size of every frame. Odd sizes are stored without chroma subsampling.
        fps: nominal rate: the length of the last frame, and what the encoder's rate control assumes.
        crf: constant rate factor of x264; 18 is nearly transparent, 28 poor.
        preset: x264's speed preset.
    """

    def __init__(
        self, path: Path, width_px: int, height_px: int, fps: float, crf: int = 20, preset: str = "veryfast"
    ) -> None:
        if width_px < 2 or height_px < 2 or fps <= 0:
            raise ValueError(f"cannot encode {width_px}x{height_px} px at {fps} frames per second")
        self._shape = (height_px, width_px, 3)
        self._subsampled = width_px % 2 == 0 and height_px % 2 == 0
        self._last_tick = -1
        self._interval = max(round(TICKS_PER_S / fps), 1)
        self._container = av.open(
            str(path),
            "w",
            format="mp4",
            # the empty edit that keeps the first timestamp is stored in the movie's own time scale: 1/1000 by default
            container_options={"movie_timescale": str(TICKS_PER_S), "fflags": "+bitexact"},
        )
        rate = Fraction(fps).limit_denominator(1001)
        options = {"crf": str(crf), "preset": preset, "bf": "0", "x264-params": "mbtree=0"}
        self._stream = self._container.add_stream("libx264", rate=rate, options=options)
        self._stream.width, self._stream.height = width_px, height_px
        self._stream.pix_fmt = "yuv420p" if self._subsampled else "yuv444p"
        self._stream.time_base = Fraction(1, TICKS_PER_S)
        codec = self._stream.codec_context
        codec.time_base = Fraction(1, TICKS_PER_S)
        codec.colorspace, codec.color_range = _BT601, _LIMITED_RANGE
        codec.gop_size = max(round(2 * fps), 1)
        codec.thread_count = 1

    def write(self, image_bgr: NDArray[np.uint8], time_ns: int) -> None:
        """Append a frame.

        Args:
            image_bgr: (height, width, 3) uint8.
            time_ns: presentation time ≥ 0, later than the frame before by more than a tick and less than 6 hours.
        """
        if image_bgr.shape != self._shape:
            raise ValueError(f"frame of shape {image_bgr.shape} in a recording of {self._shape}")
        tick = ticks_from_ns(time_ns)
        if tick <= self._last_tick:
            raise ValueError(f"frame at {time_ns} ns does not follow the one before")
        if 0 <= self._last_tick < tick - _MAX_GAP:
            raise ValueError(f"frame at {time_ns} ns follows the one before by more than an MP4 file can say")
        self._last_tick = tick
        frame = self._to_yuv(image_bgr)
        frame.pts = tick
        frame.time_base = Fraction(1, TICKS_PER_S)
        frame.duration = self._interval
        self._container.mux(self._stream.encode(frame))

    def _to_yuv(self, image_bgr: NDArray[np.uint8]) -> VideoFrame:
        # OpenCV rounds where swscale truncates, which darkens a picture by some levels, and is five times as fast
        if self._subsampled:
            frame = VideoFrame.from_ndarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2YUV_I420), format="yuv420p")
        else:
            frame = VideoFrame.from_ndarray(np.ascontiguousarray(image_bgr), format="bgr24")
            frame = frame.reformat(format="yuv444p", interpolation=ACCURATE)
        frame.colorspace, frame.color_range = _BT601, _LIMITED_RANGE
        return frame

    def close(self) -> None:
        """Write what the encoder still holds, and finish the file."""
        if self._last_tick >= 0:
            self._container.mux(self._stream.encode(None))
        self._container.close()

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
