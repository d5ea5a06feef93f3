"""CenterTrack's monocular 3D detection (Zhou et al. 2020) for any image size and camera.

A vehicle is a peak of its class's heat; the heads there give the centre of its 2D box (``reg``) and the box's size
(``wh``), from there to the projected 3D centre (``amodel_offset``), the depth along the optical axis (``dep``), the
size (``dim``: height, width, length) and alpha in two bins (``rot``). Only this module knows that order and frame.
From maps to boxes it is differentiable, and the same code in losses and at inference.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.geometry.boxes2d import distinct
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.torch_ops import CameraTensors, azimuths_rad, focal_px, intersect_plane, rays, wrap_angle
from wibam_core.models.peaks import DUPLICATE_IOU, find_peaks
from wibam_core.networks.dla34.architecture import STRIDE
from wibam_core.networks.dla34.classes import RoadUserChannels
from wibam_core.placing import Decode

Array = NDArray[np.float64]

#: Alpha in the middle of each of the two bins of ``rot``.
BIN_CENTRES_RAD = (-math.pi / 2, math.pi / 2)

#: Longer side of the input, px. 1920x1080 gives the published 800x448.
LONG_SIDE_PX = 800
#: Focal length of nuScenes's front cameras, 1266 px at a width of 1600 px, at the published input's scale.
TRAINED_FOCAL_PX = 1266.0 * LONG_SIDE_PX / 1600.0

_MULTIPLE = 32
_TOP_K = 100
#: Of pixels in 0..1; blue, green, red.
_MEAN = np.array([0.40789655, 0.44719303, 0.47026116], dtype=np.float32)
_STD = np.array([0.2886383, 0.27408165, 0.27809834], dtype=np.float32)


@dataclass(frozen=True)
class InputWarp:
    """From an image's pixels u to the network's: ``(u − size / 2)·scale + input_size / 2`` along each axis.

    This is the published warp. This project's own rule for resizing differs from it by a fraction of a pixel; the
    weights have learned this one, and it is undone as it is done. A cell of the output covers the input px that start
    at 4 times its number.

    Attributes:
        size_px: width and height of the image.
        input_px: of the input, multiples of 32: the nearest to the scaled image's, so that at most 16 rows or columns
            of the input are cut off or black.
        scale: input px per image px.
    """

    size_px: tuple[int, int]
    input_px: tuple[int, int]
    scale: float

    @classmethod
    def of(cls, width_px: int, height_px: int, long_side_px: int = LONG_SIDE_PX) -> InputWarp:
        """For images of the given size."""
        scale = long_side_px / max(width_px, height_px)
        width, height = (max(1, round(side * scale / _MULTIPLE)) * _MULTIPLE for side in (width_px, height_px))
        return cls((width_px, height_px), (width, height), scale)

    def pixels(self, cells: Array) -> Array:
        """Image px (..., 2) of fractional output cells (..., 2)."""
        return (cells * STRIDE - np.array(self.input_px) / 2) / self.scale + np.array(self.size_px) / 2

    def matrix(self) -> Array:
        """(3, 3) homogeneous image px to input px."""
        shift = np.array(self.input_px) / 2 - self.scale * np.array(self.size_px) / 2
        return np.array([[self.scale, 0.0, shift[0]], [0.0, self.scale, shift[1]], [0.0, 0.0, 1.0]])

    def image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The image (H, W, 3) as the network sees it, (H', W', 3)."""
        warped = cv2.warpAffine(image, self.matrix()[:2], self.input_px, flags=cv2.INTER_LINEAR)
        return np.asarray(warped, dtype=np.uint8)

    def camera(self, camera: Camera) -> Camera:
        """The camera of the input, for that of the image."""
        return Camera(self.matrix() @ camera.K, camera.dist, camera.T_world_cam, *self.input_px)

    def to_input(self, image: NDArray[np.uint8]) -> Tensor:
        """BGR image (H, W, 3) to the normalised input (1, 3, H', W'), float32."""
        return normalised(self.image(image)[None])


def normalised(images: NDArray[np.uint8]) -> Tensor:
    """Warped BGR images (B, H', W', 3) as the network's input (B, 3, H', W'), float32."""
    values = (images.astype(np.float32) / 255.0 - _MEAN) / _STD
    return torch.from_numpy(np.ascontiguousarray(values.transpose(0, 3, 1, 2)))


@dataclass(frozen=True, eq=False)
class HeadValues:
    """What the heads say of N cells; on the CPU, float64 but for the indices.

    Attributes:
        image: (N,) index in the batch. cells: (N, 2) x, y.
        centre2d: (N, 2) centre of the 2D box, wh: (N, 2) its size, centre3d: (N, 2) the projected 3D centre; cells.
        dep: (N,) raw, see `depths_m`. size_m: (N, 3) length, width, height. rot: (N, 8) raw, see `alphas_rad`.
    """

    image: Tensor
    cells: Tensor
    centre2d: Tensor
    wh: Tensor
    centre3d: Tensor
    dep: Tensor
    size_m: Tensor
    rot: Tensor


def read_heads(heads: Mapping[str, Tensor], image: Tensor, cells: Tensor) -> HeadValues:
    """Read raw head outputs (B, C, H, W) at cells (N, 2) x, y of the images (N,)."""
    columns, rows = cells.unbind(-1)

    def at(name: str) -> Tensor:
        return heads[name][image, :, rows, columns].cpu().double()

    centre2d = cells + at("reg")
    return HeadValues(
        image,
        cells,
        centre2d,
        at("wh"),
        centre2d + at("amodel_offset"),
        at("dep")[:, 0],
        at("dim")[:, [2, 1, 0]],
        at("rot"),
    )


def boxes3d(values: HeadValues, cameras: CameraTensors, decode: Decode) -> Tensor:
    """World boxes (N, 7) seen by the cameras (B,) of the inputs, float64.

    ``depth``, the published way: the centre lies at the depth that the network gives, on the ray through the projected
    3D centre. ``plane``: it lies where that ray meets the plane z = height / 2. There are no uncertainties to fuse the
    two by.
    """
    if decode not in ("depth", "plane"):
        raise ValueError("DLA-34's boxes are placed by 'plane' or 'depth'")
    seen_by = cameras[values.image]
    pixels = values.centre3d * STRIDE
    directions = rays(seen_by, pixels)
    if decode == "plane":
        position = intersect_plane(seen_by, pixels, values.size_m[:, 2] / 2)
    else:
        along_axis = (directions * seen_by.rotation[:, 2]).sum(dim=-1)
        position = seen_by.centre_m + directions * (depths_m(values.dep, seen_by) / along_axis)[:, None]
    yaw = wrap_angle(azimuths_rad(directions) - torch.pi / 2 - alphas_rad(values.rot))
    return torch.cat([position, values.size_m, yaw[:, None]], dim=-1)


def depths_m(dep: Tensor, cameras: CameraTensors) -> Tensor:
    """(N,) depths along the optical axes of the inputs' cameras (N,).

    The network sees only how large a thing is in its input. The same size means a depth in proportion to the focal
    length there.
    """
    trained_m = 1.0 / (dep.clamp(-50.0, 50.0).sigmoid() + 1e-6) - 1.0
    return trained_m * focal_px(cameras) / TRAINED_FOCAL_PX


def alphas_rad(rot: Tensor) -> Tensor:
    """(N,) alpha of the more probable of two bins, from (N, 8): per bin two logits, sin and cos.

    Alpha turns clockwise, seen from above, from "heads right across the line of sight". Added to the ray's angle in a
    level camera it gives the published rotation about the camera's y axis. Taken from the azimuth of the world ray it
    gives the yaw in the world, whatever the camera's pitch and roll.
    """
    in_bins = torch.atan2(rot[:, [2, 6]], rot[:, [3, 7]]) + rot.new_tensor(BIN_CENTRES_RAD)
    return torch.where(rot[:, 1] > rot[:, 5], in_bins[:, 0], in_bins[:, 1])


@dataclass(frozen=True, eq=False)
class Decoded:
    """N vehicles of one image, best first.

    Attributes:
        boxes: (N, 7) in the world.
        boxes2d: (N, 4) xyxy, px of the image.
        classes: (N,) indices into `wibam_core.road_users.CLASSES`. scores: (N,).
    """

    boxes: Array
    boxes2d: Array
    classes: NDArray[np.int64]
    scores: Array


def decode_vehicles(
    heads: Mapping[str, Tensor],
    warp: InputWarp,
    camera: Camera,
    classes: RoadUserChannels,
    *,
    min_score: float,
    decode: Decode,
) -> Decoded:
    """Vehicles from the raw head outputs of one image.

    The classes that are road users compete for a peak, so that one vehicle is not found once as a truck and once as a
    bus; of two whose 2D boxes all but coincide the weaker is left out. What has a size that no thing can have, or
    numbers that are not finite, is left out too.

    Args:
        heads: name -> (1, C, H, W), see `wibam_core.networks.dla34.architecture.HEADS`; on the CPU.
        warp: that made the input.
        camera: of the image's size.
        classes: of the heat map.
        min_score: weaker peaks are left out.
        decode: how boxes are placed along the ray, see `boxes3d`.
    """
    peaks = find_peaks(heads["hm"][:, classes.channels], min_score, _TOP_K)
    values = read_heads(heads, peaks.image, peaks.cells)
    cameras = CameraTensors.from_cameras([warp.camera(camera)], torch.float64)
    boxes = boxes3d(values, cameras, decode).numpy()
    centre2d, half = values.centre2d.numpy(), values.wh.clamp_min(0.0).numpy() / 2
    boxes2d = np.concatenate([warp.pixels(centre2d - half), warp.pixels(centre2d + half)], axis=1)
    found = Decoded(boxes, boxes2d, classes.numbers[peaks.classes.numpy()], peaks.scores.double().numpy())
    possible = np.flatnonzero(np.isfinite(np.hstack([boxes, boxes2d])).all(axis=1) & (boxes[:, 3:6] > 0).all(axis=1))
    kept = possible[distinct(boxes2d[possible], DUPLICATE_IOU)]
    return Decoded(found.boxes[kept], found.boxes2d[kept], found.classes[kept], found.scores[kept])
