"""Where the panels of a clip lie."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

#: Height of the strip beneath the panels, with the time and what the colours say, px.
STRIP_PX = 40
_GAP_PX = 4
_LEAST_SHARE, _MOST_SHARE = 0.28, 0.65
_WIDESCREEN = 16 / 9


@dataclass(frozen=True)
class Panel:
    """A rectangle of the clip, px."""

    x_px: int
    y_px: int
    width_px: int
    height_px: int


@dataclass(frozen=True)
class Layout:
    """The plan on the left, the cameras' views in a grid on its right, a strip with words beneath.

    Attributes:
        width_px, height_px: of the whole, even.
        plan: of the plan view.
        views: one a camera, in their order, all of one size.
        strip: of the words.
    """

    width_px: int
    height_px: int
    plan: Panel
    views: tuple[Panel, ...]
    strip: Panel


def arrange(width_px: int, cameras: int, aspect: float) -> Layout:
    """Share out a clip.

    Args:
        width_px: of the whole.
        cameras: how many views, at least one.
        aspect: width by height of the views.
    """
    columns = 1 if cameras <= 3 else 2 if cameras <= 8 else 3
    rows = ceil(cameras / columns)
    # as much of the width for the views as makes the clip as high as a wide screen, within limits
    share = min(max(columns * aspect / rows / _WIDESCREEN, _LEAST_SHARE), _MOST_SHARE)
    view_width = _even(share * width_px / columns - _GAP_PX)
    view_height = _even(view_width / aspect)
    height = rows * (view_height + _GAP_PX) - _GAP_PX
    left = width_px - columns * (view_width + _GAP_PX) + _GAP_PX
    views = tuple(
        Panel(
            left + (number % columns) * (view_width + _GAP_PX),
            (number // columns) * (view_height + _GAP_PX),
            view_width,
            view_height,
        )
        for number in range(cameras)
    )
    whole = _even(width_px)
    return Layout(
        whole, height + STRIP_PX, Panel(0, 0, left - _GAP_PX, height), views, Panel(0, height, whole, STRIP_PX)
    )


def _even(length: float) -> int:
    return max(int(length) // 2 * 2, 2)
