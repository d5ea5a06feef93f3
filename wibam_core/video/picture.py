"""From decoded frames to pictures as a player shows them: turned, mirrored, deinterlaced, in BGR."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import cast

import av
import cv2
import numpy as np
from av.video.frame import VideoFrame
from numpy.typing import NDArray

from wibam_core.errors import UnreadableVideo
from wibam_core.geometry.pixels import resized_height_px, shrunk_image
from wibam_core.video.source import ACCURATE, ACCURATE_BY_AREA

Image = NDArray[np.uint8]
Size = tuple[int, int]

#: AVColorSpace: unspecified, BT.470BG, SMPTE 170M. AVColorRange "JPEG" (0–255).
_BT601_MATRICES, _FULL_RANGE = (2, 5, 6), 2
#: A display matrix whose small elements are below this share of the large ones turns by quarters.
_QUARTER_TOLERANCE = 0.01


@dataclass(frozen=True)
class Orientation:
    """How a stored picture is shown, one of eight ways: transposed, then mirrored left-right, then top-bottom."""

    transposed: bool = False
    mirrored_x: bool = False
    mirrored_y: bool = False

    @classmethod
    def of(cls, frame: VideoFrame) -> Orientation:
        """What the frame's display matrix says (ISO/IEC 14496-12, 8.3.2: x' = a x + c y, y' = b x + d y).

        Raises:
            UnreadableVideo: it turns by something else than quarters.
        """
        side_data = frame.side_data.get("DISPLAYMATRIX")
        if side_data is None:
            return cls()
        a, b, _, c, d = np.frombuffer(cast("memoryview", side_data), dtype=np.int32)[:5].tolist()
        straight, across = max(abs(a), abs(d)), max(abs(b), abs(c))
        if min(abs(a), abs(d)) > 0 and across <= _QUARTER_TOLERANCE * straight:
            return cls(False, a < 0, d < 0)
        if min(abs(b), abs(c)) > 0 and straight <= _QUARTER_TOLERANCE * across:
            return cls(True, c < 0, b < 0)
        raise UnreadableVideo(
            f"the file says that its picture is to be shown turned by {math.degrees(math.atan2(b, a)):.0f}°; "
            "only quarter turns and mirrors are read",
            hint="Re-encode it as it is to be shown.",
        )

    @property
    def rotation_deg(self) -> int:
        """The turn counter-clockwise, after the mirror where there is one: 0, 90, 180 or 270."""
        if not self.transposed:
            return 180 if self.mirrored_y else 0
        return 270 if self.mirrored_x else 90

    @property
    def mirrored(self) -> bool:
        """Whether left and right are exchanged, before the turn."""
        return self.transposed ^ self.mirrored_x ^ self.mirrored_y

    def size(self, stored: Size) -> Size:
        """Width and height as shown."""
        return (stored[1], stored[0]) if self.transposed else stored

    def apply(self, image: Image) -> Image:
        """A picture as it is shown."""
        if self.transposed:
            image = np.asarray(cv2.transpose(image), dtype=np.uint8)
        if self.mirrored_x or self.mirrored_y:
            axes = -1 if self.mirrored_x and self.mirrored_y else int(self.mirrored_x)
            image = np.asarray(cv2.flip(image, axes), dtype=np.uint8)
        return image


class Orientations:
    """How the frames of one file are shown, in the order decoded.

    Side data is looked at in the first frame, and where the turn that it says changes: a frame whose side data was
    looked at and the object that stands for these hold each other, so that its picture, megabytes of it, stays in
    memory until Python next searches for such garbage.
    """

    def __init__(self) -> None:
        self._last: Orientation | None = None
        self._turn_deg = 0

    def of(self, frame: VideoFrame) -> Orientation:
        """As `Orientation.of`."""
        if self._last is None or frame.rotation != self._turn_deg:
            self._last = Orientation.of(frame)
            self._turn_deg = frame.rotation
        return self._last


def to_bgr(frame: VideoFrame, orientation: Orientation, size_px: Size | None, width_px: int | None) -> Image:
    """A frame as it is shown, (H, W, 3) uint8.

    Args:
        frame: the frame.
        orientation: how it is shown.
        size_px: width and height that all pictures are brought to; None: as they are.
        width_px: shrink what is then wider to this width, by area, keeping the aspect ratio.
    """
    shown = orientation.size((frame.width, frame.height))
    if width_px is not None and shown[0] > width_px and size_px in (None, shown):
        return _shrunk(frame, orientation, (width_px, resized_height_px(*shown, width_px)))
    if _is_plain(frame):
        image = np.asarray(cv2.cvtColor(frame.to_ndarray(), cv2.COLOR_YUV2BGR_I420), dtype=np.uint8)
    else:
        image = np.asarray(frame.to_ndarray(format="bgr24", interpolation=ACCURATE), dtype=np.uint8)
    image = orientation.apply(image)
    if size_px is not None and (image.shape[1], image.shape[0]) != size_px:
        smaller = size_px[0] * size_px[1] < image.shape[0] * image.shape[1]
        how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
        image = np.asarray(cv2.resize(image, size_px, interpolation=how), dtype=np.uint8)
    return image if width_px is None else shrunk_image(image, width_px)


def _shrunk(frame: VideoFrame, orientation: Orientation, size: Size) -> Image:
    """A frame as it is shown, at a smaller size: shrunk and converted in one go, which is three times as fast."""
    width, height = orientation.size(size)  # as it is stored: a transposition is its own inverse
    image = frame.to_ndarray(width=width, height=height, format="bgr24", interpolation=ACCURATE_BY_AREA)
    return orientation.apply(np.asarray(image, dtype=np.uint8))


def _is_plain(frame: VideoFrame) -> bool:
    """Whether a frame is what OpenCV's I420 is: BT.601, limited range, even size. OpenCV converts it faster."""
    return (
        frame.format.name == "yuv420p"
        and frame.colorspace in _BT601_MATRICES
        and frame.color_range != _FULL_RANGE
        and frame.width % 2 == 0
        and frame.height % 2 == 0
    )


class Deinterlacer:
    """Joins the fields of interlaced frames (FFmpeg's yadif), a frame for each frame; others pass as they are.

    Frames go through it from the first interlaced one on, each with whatever is known of it.
    """

    def __init__(self) -> None:
        self._graph: av.filter.Graph | None = None
        self._layout: tuple[int, int, str] | None = None
        self._waiting: deque[tuple[int, Orientation]] = deque()
        self._pushed = 0

    def push(
        self, time_ns: int, frame: VideoFrame, orientation: Orientation
    ) -> Iterator[tuple[int, VideoFrame, Orientation]]:
        """Give a frame; returns those that are ready."""
        layout = (frame.width, frame.height, frame.format.name)
        if self._graph is None and not frame.interlaced_frame:
            yield time_ns, frame, orientation
            return
        if self._layout != layout:
            yield from self.flush()
            self._graph, self._layout = _deinterlacing(layout), layout
        assert self._graph is not None
        frame.pts, frame.time_base = self._pushed, Fraction(1, 1000)
        self._pushed += 1
        self._waiting.append((time_ns, orientation))
        self._graph.push(frame)
        yield from self._ready()

    def flush(self) -> Iterator[tuple[int, VideoFrame, Orientation]]:
        """The frames that are left."""
        if self._graph is not None:
            self._graph.push(None)
            yield from self._ready()
        self._graph = self._layout = None

    def _ready(self) -> Iterator[tuple[int, VideoFrame, Orientation]]:
        assert self._graph is not None
        while True:
            try:
                frame = self._graph.pull()
            except (av.BlockingIOError, av.EOFError):
                return
            time_ns, orientation = self._waiting.popleft()
            yield time_ns, frame, orientation


def _deinterlacing(layout: tuple[int, int, str]) -> av.filter.Graph:
    width, height, pixel_format = layout
    graph = av.filter.Graph()
    source = graph.add_buffer(width=width, height=height, format=pixel_format, time_base=Fraction(1, 1000))
    yadif = graph.add("yadif", "mode=send_frame:deint=interlaced")
    sink = graph.add("buffersink")
    source.link_to(yadif)
    yadif.link_to(sink)
    graph.configure()
    return graph
