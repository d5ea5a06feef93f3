"""Crops around 2D boxes, as the edge refiner sees them."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.detection.boxes import FloatArray, Image
from wibam_core.detection.planes import shares_of
from wibam_core.geometry.pixels import resized_image

#: Sides of the box that a crop shows, and its side in px.
CONTEXT = 1.5
CROP_PX = 96


class Window(NamedTuple):
    """Whole pixels x0, y0 .. x1, y1 (ends exclusive), which may reach beyond the image."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.x1 - self.x0, self.y1 - self.y0

    def to_px(self, edges: FloatArray) -> FloatArray:
        """Edges (..., 4) in shares of the window to xyxy px, where (0, 0) is the centre of the image's first pixel."""
        low = np.array([self.x0, self.y0] * 2) - 0.5
        return np.asarray(low + edges * np.tile(self.size, 2))

    def to_shares(self, box: FloatArray) -> FloatArray:
        """The inverse of `to_px`."""
        low = np.array([self.x0, self.y0] * 2) - 0.5
        return np.asarray((box - low) / np.tile(self.size, 2))


def window(box: FloatArray) -> Window:
    """The window around a box (4,) xyxy, px."""
    centre, half = (box[:2] + box[2:]) / 2, CONTEXT * np.maximum(box[2:] - box[:2], 4.0) / 2
    low = np.floor(centre - half + 0.5).astype(int)
    high = np.maximum(np.ceil(centre + half + 0.5).astype(int), low + 2)
    return Window(int(low[0]), int(low[1]), int(high[0]), int(high[1]))


def crop(image: Image, window: Window) -> NDArray[np.uint8]:
    """The window of an image (H, W, C), C at most 4, its border repeated outwards, as (96, 96, C)."""
    height, width = image.shape[:2]
    x0, y0, x1, y1 = window
    inside = image[max(y0, 0) : min(y1, height), max(x0, 0) : min(x1, width)]
    margins = (max(-y0, 0), max(y1 - height, 0), max(-x0, 0), max(x1 - width, 0))
    if any(margins):
        inside = cv2.copyMakeBorder(inside, *margins, cv2.BORDER_REPLICATE)
    return resized_image(np.asarray(inside, dtype=np.uint8), CROP_PX, CROP_PX)


def blob(image: Image, still: Image, boxes: FloatArray) -> tuple[NDArray[np.float32], list[Window]]:
    """Crops (N, 7, 96, 96) of the image, the background and where that is known, and their windows.

    Args:
        image: (H, W, 3) uint8, BGR.
        still: (H, W, 4) uint8: the same without vehicles, and 255 where that is known, else 0.
        boxes: (N, 4) xyxy, px.
    """
    windows = [window(box) for box in boxes]
    crops = np.empty((len(boxes), 7, CROP_PX, CROP_PX), np.float32)
    for row, where in enumerate(windows):
        crops[row] = shares_of((*cv2.split(crop(image, where)), *cv2.split(crop(still, where))))
    return crops, windows
