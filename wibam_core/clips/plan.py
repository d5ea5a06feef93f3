"""The plan of a clip: the road from above, as the cameras see it, with trails, footprints and conflicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.clips.colours import Bgr
from wibam_core.clips.layout import Panel
from wibam_core.report.mosaic import Extent

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

INK: Bgr = (51, 39, 29)
ALERT: Bgr = (40, 40, 200)
_WHITE: Bgr = (255, 255, 255)
_SHIFT = 4
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True)
class PlanFrame:
    """A plan of one size and one place, to draw on.

    Attributes:
        extent: what of the ground it shows, of the panel's aspect.
        px_per_m: its scale.
    """

    extent: Extent
    px_per_m: float

    @classmethod
    def around(cls, extent: Extent, panel: Panel) -> PlanFrame:
        """One that shows an extent, and more of what lies beside it where the panel is longer."""
        width, height = extent.x_max_m - extent.x_min_m, extent.y_max_m - extent.y_min_m
        scale = min(panel.width_px / width, panel.height_px / height)
        half_x, half_y = 0.5 * panel.width_px / scale, 0.5 * panel.height_px / scale
        x, y = 0.5 * (extent.x_min_m + extent.x_max_m), 0.5 * (extent.y_min_m + extent.y_max_m)
        return cls(Extent(x - half_x, x + half_x, y - half_y, y + half_y), scale)

    def px(self, points: ArrayLike) -> Array:
        """Pixels (..., 2) of the panel of ground points (..., 2) in m; y points up in the world."""
        array = np.asarray(points, dtype=np.float64)
        x = (array[..., 0] - self.extent.x_min_m) * self.px_per_m - 0.5
        y = (self.extent.y_max_m - array[..., 1]) * self.px_per_m - 0.5
        return np.stack([x, y], axis=-1)

    def line(self, image: Image, points: ArrayLike, colour: Bgr, width_px: int, *, closed: bool = False) -> None:
        """A line through ground points (N, 2)."""
        cv2.polylines(image, [self._fixed(points)], closed, colour, width_px, cv2.LINE_AA, _SHIFT)

    def fill(self, image: Image, points: ArrayLike, colour: Bgr) -> None:
        """A polygon of ground points (N, 2)."""
        cv2.fillPoly(image, [self._fixed(points)], colour, cv2.LINE_AA, _SHIFT)

    def ring(self, image: Image, point: ArrayLike, radius_px: int, colour: Bgr) -> None:
        """A ring with a cross around a ground point (2,)."""
        u, v = (int(value) for value in np.rint(np.clip(self.px(point), -1e6, 1e6)))
        cv2.circle(image, (u, v), radius_px, colour, 3, cv2.LINE_AA)
        for du, dv in ((radius_px + 6, 0), (0, radius_px + 6)):
            cv2.line(image, (u - du, v - dv), (u + du, v + dv), colour, 1, cv2.LINE_AA)

    def _fixed(self, points: ArrayLike) -> NDArray[np.int32]:
        # what lies far outside is cut: OpenCV's numbers end at 2^31
        return np.rint(np.clip(self.px(points), -1e6, 1e6) * (1 << _SHIFT)).astype(np.int32)


def draw_footprint(image: Image, plan: PlanFrame, corners: Array, colour: Bgr, *, marked: bool) -> None:
    """A road user from above: its ground rectangle (4, 2), corners as in `box3d.footprints`, a line to its front."""
    plan.fill(image, corners, colour)
    plan.line(image, corners, ALERT if marked else INK, 3 if marked else 1, closed=True)
    front = 0.5 * (corners[0] + corners[3])
    plan.line(image, [corners.mean(axis=0), front], _WHITE, 2)


def scale_bar(image: Image, plan: PlanFrame) -> None:
    """A bar of a round length in the lower left corner."""
    length_m = next((m for m in (100, 50, 20, 10, 5, 2) if m * plan.px_per_m <= 0.25 * image.shape[1]), 1)
    x, y, width = 14, image.shape[0] - 16, round(length_m * plan.px_per_m)
    cv2.line(image, (x, y), (x + width, y), INK, 3, cv2.LINE_AA)
    write(image, f"{length_m} m", (x, y - 8))


def write(image: Image, text: str, at: tuple[int, int], colour: Bgr = INK, scale: float = 0.5) -> int:
    """Text of plain letters with its lower left corner at a pixel; returns how wide it is, px."""
    cv2.putText(image, text, at, _FONT, scale, colour, 1, cv2.LINE_AA)
    return int(cv2.getTextSize(text, _FONT, scale, 1)[0][0])


def label(image: Image, text: str) -> None:
    """A name in the upper left corner, readable on any picture."""
    width = cv2.getTextSize(text, _FONT, 0.5, 1)[0][0]
    cv2.rectangle(image, (0, 0), (width + 12, 22), INK, cv2.FILLED)
    write(image, text, (6, 16), _WHITE)


def legend(image: Image, entries: Sequence[tuple[str, Bgr]], x: int) -> None:
    """Names with their colours in a strip, from a column on; what has no room is left out."""
    y = image.shape[0] // 2
    for name, colour in entries:
        if x + 30 + 9 * len(name) > image.shape[1]:
            return
        cv2.rectangle(image, (x, y - 7), (x + 14, y + 7), colour, cv2.FILLED)
        x += 20
        x += write(image, name, (x, y + 5)) + 18
