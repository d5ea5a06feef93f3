"""One image at several sizes: where its pixels are, and what it looks like.

Pixel (0, 0) is the centre of the top-left pixel. An image resized by s shows at (u + 0.5)·s − 0.5 what it showed at u,
so that its corner, at −0.5, stays where it is. Cells of a network's map are pixels of an image reduced by its stride.
"""

from __future__ import annotations

from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Size = tuple[int, int]
#: An array or a tensor; this module does not import torch.
_Pixels = TypeVar("_Pixels", bound=Any)


def resized_px(pixels: _Pixels, scale: Any) -> _Pixels:
    """Where pixels (..., 2k) come to lie, of the same kind as they are: NumPy arrays or tensors.

    Args:
        pixels: u and v in turn: points, or xyxy boxes.
        scale: new size over old, the same for both axes or of each (..., 2k), see `scale_of`. Its inverse leads back.
    """
    moved: _Pixels = (pixels + 0.5) * scale - 0.5
    return moved


def scale_of(size: Size, new_size: Size, coordinates: int = 2) -> Array:
    """New size over old, both width and height in px: (2,), or (4,) for the ``coordinates`` of an xyxy box."""
    return np.tile(np.array(new_size) / np.array(size), coordinates // 2)


def resized_intrinsics(K: Array, scale: Array) -> Array:
    """The intrinsic matrix (3, 3) of an image that is resized by ``scale`` (2,)."""
    sx, sy = scale
    return np.array([[sx, 0, 0.5 * sx - 0.5], [0, sy, 0.5 * sy - 0.5], [0, 0, 1]]) @ K


def resized_height_px(width_px: int, height_px: int, new_width_px: int) -> int:
    """Height of an image of the given size at another width, its aspect ratio kept."""
    return max(round(height_px * new_width_px / width_px), 1)


def resized_image(image: Image, width_px: int, height_px: int) -> Image:
    """An image (H, W, C), C at most 4, at another size: by area where it shrinks along either axis, else bilinear."""
    if image.shape[:2] == (height_px, width_px):
        return image
    shrinks = image.shape[1] > width_px or image.shape[0] > height_px
    interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (width_px, height_px), interpolation=interpolation), dtype=np.uint8)


def shrunk_image(image: Image, width_px: int) -> Image:
    """An image (H, W, C) no wider than ``width_px``, its aspect ratio kept; narrower ones stay as they are."""
    height, width = image.shape[:2]
    return image if width <= width_px else resized_image(image, width_px, resized_height_px(width, height, width_px))
