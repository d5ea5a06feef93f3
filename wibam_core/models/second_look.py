"""A second look at each vehicle that a network found: where the edges of the whole of it are, and how sure that is.

A network sees the whole image, reduced, at a quarter of its resolution. The edge refiner sees each vehicle by itself,
in all the pixels that there are, and knows how far vehicles go on behind what hides them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.detection.background import StillBackground
from wibam_core.detection.boxes import Found
from wibam_core.detection.edge_refiner import EdgeRefiner
from wibam_core.geometry.boxes2d import clipped_to_image, sides_px

FloatArray = NDArray[np.float64]

#: Smaller boxes are not looked at, px.
_LEAST_SIDE_PX = 2.0


class Edges(NamedTuple):
    """Edges of whole vehicles, left, top, right, bottom.

    Attributes:
        px: (N, 4). sd_px: (N, 4) their standard deviations, infinite for what was not looked at. Both float64.
    """

    px: Tensor
    sd_px: Tensor


class SecondLook:
    """Runs the bundled edge refiner on one image's boxes, on one thread; several threads may share one."""

    def __init__(self) -> None:
        self._refiner = EdgeRefiner()

    def edges(self, image: NDArray[np.uint8], boxes: FloatArray) -> Edges:
        """Edges within the image, in the order of the boxes.

        What the camera shows without vehicles is taken as unknown: to know it gains little here.

        Args:
            image: (H, W, 3) uint8, BGR.
            boxes: (N, 4) xyxy of vehicles in it, px; what is not finite or out of the image is not looked at.
        """
        height, width = image.shape[:2]
        inside = clipped_to_image(np.nan_to_num(boxes), width, height)
        sound = np.isfinite(boxes).all(axis=1) & (sides_px(inside) >= _LEAST_SIDE_PX).all(axis=1)
        px, sd_px = inside, np.full(inside.shape, np.inf)
        if sound.any():
            alike = np.zeros(int(sound.sum()))
            found = Found(inside[sound], alike, alike.astype(np.int64))
            unknown = StillBackground.unknown(height, width)
            seen = self._refiner.refine(image, unknown, found, nms_iou=1.0, classify=False, passes=1)
            px[sound], sd_px[sound] = seen.amodal_boxes, seen.amodal_sd
        return Edges(torch.from_numpy(px), torch.from_numpy(sd_px))
