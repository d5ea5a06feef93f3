"""Images as networks see them: a frame and its camera, resized to the network's input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.geometry.camera import Camera
from wibam_core.geometry.pixels import resized_height_px, resized_image
from wibam_core.models.trunk import INPUT_MULTIPLE

#: Width of the images that a network sees unless it is told otherwise, px.
INPUT_WIDTH_PX = 640


@dataclass(frozen=True, eq=False)
class Frame:
    """One image to detect vehicles in.

    Attributes:
        image: (H, W, 3) uint8, BGR, any size.
        camera: of any image size with the image's aspect ratio; resized to the image here.
        camera_id: copied to the output. time_ns: copied to the output.
    """

    image: NDArray[np.uint8]
    camera: Camera
    camera_id: str
    time_ns: int

    def __post_init__(self) -> None:
        if self.image.ndim != 3 or self.image.shape[2] != 3 or self.image.dtype != np.uint8:
            raise ValueError(f"a frame needs (H, W, 3) uint8, got {self.image.shape} {self.image.dtype}")


def prepare_image(image: NDArray[np.uint8], input_width_px: int = INPUT_WIDTH_PX) -> NDArray[np.uint8]:
    """Resize (H, W, 3) to the input width and pad at the bottom, in black, to a multiple of 32 rows."""
    height = resized_height_px(image.shape[1], image.shape[0], input_width_px)
    image = resized_image(image, input_width_px, height)
    padding = -height % INPUT_MULTIPLE
    return np.pad(image, ((0, padding), (0, 0), (0, 0))) if padding else image


def prepare_camera(camera: Camera, input_width_px: int = INPUT_WIDTH_PX) -> Camera:
    """The camera of the prepared image (its size is the content's, without the padding)."""
    return camera.resized(input_width_px, resized_height_px(camera.width_px, camera.height_px, input_width_px))


def to_input(
    images: NDArray[np.uint8] | Tensor,
    device: torch.device | str = "cpu",
    layout: torch.memory_format = torch.channels_last,
) -> Tensor:
    """Prepared images (B, H, W, 3) uint8 to the network's input (B, 3, H, W) float32 in 0..1.

    Args:
        images: of one size.
        device: where the input is to lie.
        layout: the order in memory; torch's networks are fastest with the channels last.
    """
    batch = images if isinstance(images, Tensor) else torch.from_numpy(np.ascontiguousarray(images))
    batch = batch.to(device).permute(0, 3, 1, 2)
    return batch.to(torch.float32, memory_format=layout).div_(255.0)
