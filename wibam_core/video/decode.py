"""Frames by presentation timestamp. Frame numbers do not exist here: cameras drop frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np
from av.video.frame import VideoFrame
from numpy.typing import NDArray

from wibam_core.geometry.pixels import shrunk_image
from wibam_core.video.source import ACCURATE, ns_from_pts, open_video

Image = NDArray[np.uint8]

_QUARTER_TURNS = {90: cv2.ROTATE_90_COUNTERCLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_CLOCKWISE}
#: AVColorSpace: unspecified, BT.470BG, SMPTE 170M. AVColorRange "JPEG" (0–255).
_BT601_MATRICES, _FULL_RANGE = (2, 5, 6), 2


@dataclass(frozen=True, eq=False)
class NearestFrame:
    """The frame nearest to a wanted time.

    Attributes:
        target_ns: the wanted time. time_ns: the frame's own time. Both on the recording's clock.
        image_bgr: (H, W, 3) uint8. Two targets nearest to one frame share one image.
    """

    target_ns: int
    time_ns: int
    image_bgr: Image


def decode(path: Path, *, width_px: int | None = None, threads: int = 1) -> Iterator[tuple[int, Image]]:
    """Every frame of a recording: (presentation time in ns, BGR image (H, W, 3) uint8), times strictly increasing.

    Damaged frames are left out.

    Args:
        path: the file.
        width_px: shrink frames that are wider to this width, by area, keeping the aspect ratio.
        threads: decoding threads.

    Raises:
        UnreadableVideo: the file cannot be opened.
    """
    for time_ns, frame in _frames(path, threads):
        yield time_ns, to_bgr(frame, width_px)


def frames_nearest(
    path: Path, times_ns: Iterable[int], *, tolerance_ns: int, width_px: int | None = None, threads: int = 1
) -> Iterator[NearestFrame]:
    """For each wanted time the nearest frame, in one pass over the file.

    Wanted times without a frame within the tolerance yield nothing. Only chosen frames are converted to BGR.

    Args:
        path: the file.
        times_ns: wanted times on the recording's clock, ascending.
        tolerance_ns: largest distance of a frame from its wanted time.
        width_px: as in `decode`.
        threads: decoding threads.

    Raises:
        UnreadableVideo: the file cannot be opened.
        ValueError: the wanted times descend.
    """
    one_pass = OnePass(path, width_px=width_px, threads=threads)
    for target in times_ns:
        found = one_pass.nearest(target, tolerance_ns)
        if found is not None:
            yield found


class OnePass:
    """Looks for frames in one pass over a recording, which is opened when the first one is asked for.

    Args:
        path: the file.
        among: times of the frames that count; None: all.
        width_px: as in `decode`.
        threads: decoding threads.
    """

    def __init__(
        self, path: Path, *, among: Set[int] | None = None, width_px: int | None = None, threads: int = 1
    ) -> None:
        frames = _frames(path, threads)
        self._frames = frames if among is None else (frame for frame in frames if frame[0] in among)
        self._width_px = width_px
        self._before: tuple[int, VideoFrame] | None = None
        self._after: tuple[int, VideoFrame] | None = None
        self._last_target_ns: int | None = None
        self._chosen: NearestFrame | None = None

    def nearest(self, target_ns: int, tolerance_ns: int) -> NearestFrame | None:
        """The frame nearest to a time (the earlier of two equally near), None where none is within the tolerance.

        Raises:
            UnreadableVideo: the file cannot be opened.
            ValueError: a later time was asked for before.
        """
        if self._last_target_ns is None:
            self._after = next(self._frames, None)
        elif target_ns < self._last_target_ns:
            raise ValueError("wanted times must ascend")
        self._last_target_ns = target_ns
        while self._after is not None and self._after[0] < target_ns:
            self._before, self._after = self._after, next(self._frames, None)
        candidates = [frame for frame in (self._before, self._after) if frame is not None]
        time_ns, frame = min(candidates, key=lambda candidate: abs(candidate[0] - target_ns), default=(0, None))
        if frame is None or abs(time_ns - target_ns) > tolerance_ns:
            return None
        image = self._chosen.image_bgr if self._chosen and self._chosen.time_ns == time_ns else None
        self._chosen = NearestFrame(target_ns, time_ns, to_bgr(frame, self._width_px) if image is None else image)
        return self._chosen


def _frames(path: Path, threads: int) -> Iterator[tuple[int, VideoFrame]]:
    """Sound frames in the order of time, each time once, all of the first one's size."""
    last_ns: int | None = None
    size: tuple[int, int] | None = None
    with open_video(path, threads) as (container, stream):
        for frame in _decoded(container, stream):
            if frame.pts is None or frame.time_base is None or frame.is_corrupt:
                continue
            time_ns = ns_from_pts(frame.pts, frame.time_base)
            size = size or (frame.width, frame.height)
            if (last_ns is not None and time_ns <= last_ns) or (frame.width, frame.height) != size:
                continue
            last_ns = time_ns
            yield time_ns, frame


def _decoded(container: av.container.InputContainer, stream: av.video.stream.VideoStream) -> Iterator[VideoFrame]:
    """Whatever the decoder gives, past packets that it refuses, to the end or to where the file is cut off."""
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets)
        except StopIteration:
            return
        except (av.FFmpegError, EOFError):
            break
        try:
            frames = stream.decode(packet)
        except av.FFmpegError:
            continue
        yield from frames
    yield from stream.decode(None)


def _is_plain(frame: VideoFrame) -> bool:
    """Whether a frame is what OpenCV's I420 is: BT.601, limited range, even size. OpenCV converts it faster."""
    return (
        frame.format.name == "yuv420p"
        and frame.colorspace in _BT601_MATRICES
        and frame.color_range != _FULL_RANGE
        and frame.width % 2 == 0
        and frame.height % 2 == 0
    )


def to_bgr(frame: VideoFrame, width_px: int | None) -> Image:
    """A decoded frame as it is to be seen, turned as its file says, (H, W, 3) uint8; ``width_px`` as in `decode`."""
    if _is_plain(frame):
        image = np.asarray(cv2.cvtColor(frame.to_ndarray(), cv2.COLOR_YUV2BGR_I420), dtype=np.uint8)
    else:
        image = np.asarray(frame.to_ndarray(format="bgr24", interpolation=ACCURATE), dtype=np.uint8)
    turn = _QUARTER_TURNS.get(int(frame.rotation) % 360)
    if turn is not None:
        image = np.asarray(cv2.rotate(image, turn), dtype=np.uint8)
    return image if width_px is None else shrunk_image(image, width_px)
