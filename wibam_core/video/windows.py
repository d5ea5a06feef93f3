"""Small windows of frames, cut out before conversion to BGR, which costs more for a whole frame than decoding it."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import av
from av.video.frame import VideoFrame

from wibam_core.video.picture import Image, Orientation, Size, to_bgr

#: x0, y0, x1, y1 of a window in a picture as it is shown, px; x1 and y1 are the first column and row beyond it.
Window = tuple[int, int, int, int]

#: What is cut out is larger by so much on each side, and begins at a multiple of it: colours are stored at half or a
#: quarter of the resolution, and are interpolated between neighbours.
_MARGIN_PX = 8


class Windows:
    """Cuts the same windows from every frame of a recording, as they look in the whole pictures.

    Args:
        windows: where they are; within the pictures, and not empty.
        size_px: width and height that all pictures are brought to.
    """

    def __init__(self, windows: Sequence[Window], size_px: Size) -> None:
        self._windows, self._size_px = windows, size_px
        self._layout: tuple[int, int, str, Orientation] | None = None
        self._cutters: list[_Cutter] = []

    def of(self, frame: VideoFrame, orientation: Orientation) -> list[Image]:
        """The windows' pictures, each (y1 - y0, x1 - x0, 3) uint8, BGR."""
        if orientation.size((frame.width, frame.height)) != self._size_px:
            whole = to_bgr(frame, orientation, self._size_px, None)
            return [whole[y0:y1, x0:x1] for x0, y0, x1, y1 in self._windows]
        if frame.width % 2 or frame.height % 2:
            # FFmpeg's crop leaves out a last column or row that shares its colour with none
            whole = to_bgr(frame, orientation, None, None)
            return [whole[y0:y1, x0:x1] for x0, y0, x1, y1 in self._windows]
        layout = (frame.width, frame.height, frame.format.name, orientation)
        if self._layout != layout:
            self._layout = layout
            self._cutters = [_Cutter(frame, orientation, window) for window in self._windows]
        return [cutter.cut(frame) for cutter in self._cutters]


class _Cutter:
    """Cuts one window from frames of one size and pixel format, by FFmpeg's crop, which copies nothing."""

    def __init__(self, frame: VideoFrame, orientation: Orientation, window: Window) -> None:
        self._orientation, self._window = orientation, window
        left, top, right, bottom = _as_stored(window, orientation, (frame.width, frame.height))
        x0, y0 = (max(edge - _MARGIN_PX, 0) // _MARGIN_PX * _MARGIN_PX for edge in (left, top))
        x1 = min(-(-(right + _MARGIN_PX) // _MARGIN_PX) * _MARGIN_PX, frame.width)
        y1 = min(-(-(bottom + _MARGIN_PX) // _MARGIN_PX) * _MARGIN_PX, frame.height)
        shown = _as_shown((x0, y0, x1, y1), orientation, (frame.width, frame.height))
        self._within = (
            slice(window[1] - shown[1], window[3] - shown[1]),
            slice(window[0] - shown[0], window[2] - shown[0]),
        )
        self._graph = av.filter.Graph()
        source = self._graph.add_buffer(
            width=frame.width, height=frame.height, format=frame.format.name, time_base=Fraction(1, 1000)
        )
        crop = self._graph.add("crop", f"{x1 - x0}:{y1 - y0}:{x0}:{y0}")
        sink = self._graph.add("buffersink")
        source.link_to(crop)
        crop.link_to(sink)
        self._graph.configure()

    def cut(self, frame: VideoFrame) -> Image:
        self._graph.push(frame)
        part = self._graph.pull()
        assert isinstance(part, VideoFrame), "pictures come out of where pictures go in"
        return to_bgr(part, self._orientation, None, None)[self._within]


def _as_stored(window: Window, orientation: Orientation, stored: Size) -> Window:
    """A window of the picture as it is shown, in the picture as it is stored."""
    x0, y0, x1, y1 = _mirrored(window, orientation, orientation.size(stored))
    return (y0, x0, y1, x1) if orientation.transposed else (x0, y0, x1, y1)


def _as_shown(window: Window, orientation: Orientation, stored: Size) -> Window:
    """A window of the picture as it is stored, in the picture as it is shown."""
    x0, y0, x1, y1 = window
    turned = (y0, x0, y1, x1) if orientation.transposed else window
    return _mirrored(turned, orientation, orientation.size(stored))


def _mirrored(window: Window, orientation: Orientation, shown: Size) -> Window:
    x0, y0, x1, y1 = window
    if orientation.mirrored_x:
        x0, x1 = shown[0] - x1, shown[0] - x0
    if orientation.mirrored_y:
        y0, y1 = shown[1] - y1, shown[1] - y0
    return x0, y0, x1, y1
