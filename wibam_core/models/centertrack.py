"""CenterTrack's monocular 3D detection (Zhou et al. 2020) for any image size and camera.

A vehicle is a peak of its class's heat; the heads there give the centre of its 2D box (``reg``) and the box's size
(``wh``), from there to the projected 3D centre (``amodel_offset``), the depth along the optical axis (``dep``), the
size (``dim``: height, width, length) and alpha in two bins (``rot``). Only this module knows that order and frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.models.decode import find_peaks
from wibam_core.models.dla34 import DLA34, STRIDE
from wibam_core.models.inference import Frame, distinct
from wibam_core.scene import VehicleClass, Vehicles3D

Array = NDArray[np.float64]

#: The heat map's channels in order.
NUSCENES_CLASSES = (
    "car",
    "truck",
    "bus",
    "trailer",
    "construction_vehicle",
    "pedestrian",
    "motorcycle",
    "bicycle",
    "traffic_cone",
    "barrier",
)

#: Which of them are vehicles here. Vans count as cars there. A trailer is a box of its own behind its truck's: taken as
#: a vehicle it would follow its truck without a gap, and be in conflict with it all the time.
VEHICLES: Mapping[str, VehicleClass] = MappingProxyType(
    {
        "car": VehicleClass.CAR,
        "truck": VehicleClass.TRUCK,
        "bus": VehicleClass.BUS,
        "construction_vehicle": VehicleClass.TRUCK,
    }
)

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

    def to_input(self, image: NDArray[np.uint8]) -> Tensor:
        """BGR image (H, W, 3) to the normalised input (1, 3, H', W'), float32."""
        shift = np.array(self.input_px) / 2 - self.scale * np.array(self.size_px) / 2
        matrix = np.array([[self.scale, 0.0, shift[0]], [0.0, self.scale, shift[1]]])
        warped = cv2.warpAffine(image, matrix, self.input_px, flags=cv2.INTER_LINEAR)
        normalised = (np.asarray(warped, dtype=np.float32) / 255.0 - _MEAN) / _STD
        return torch.from_numpy(np.ascontiguousarray(normalised.transpose(2, 0, 1)))[None]


@dataclass(frozen=True, eq=False)
class Decoded:
    """N vehicles of one image, best first.

    Attributes:
        boxes: (N, 7) in the world.
        boxes2d: (N, 4) xyxy, px of the image.
        classes: (N,) indices into `wibam_core.scene.CLASSES`. scores: (N,).
    """

    boxes: Array
    boxes2d: Array
    classes: NDArray[np.int64]
    scores: Array


def decode_vehicles(heads: Mapping[str, Tensor], warp: InputWarp, camera: Camera, min_score: float) -> Decoded:
    """Vehicles from the raw head outputs of one image.

    The classes that are vehicles compete for a peak, so that one vehicle is not found once as a truck and once as a
    bus; of two whose 2D boxes all but coincide the weaker is left out. What has a size that no thing can have, or
    numbers that are not finite, is left out too.

    Args:
        heads: name -> (1, C, H, W), see `wibam_core.models.dla34.HEADS`.
        warp: that made the input.
        camera: of the image's size.
        min_score: weaker peaks are left out.
    """
    channels = [NUSCENES_CLASSES.index(name) for name in VEHICLES]
    peaks = find_peaks(heads["hm"][:, channels], min_score, _TOP_K)
    columns, rows = peaks.cells.unbind(-1)
    at = {name: values[0, :, rows, columns].T.double().numpy() for name, values in heads.items()}
    centre2d = peaks.cells.double().numpy() + at["reg"]
    half = np.maximum(at["wh"], 0.0) / 2
    boxes2d = np.concatenate([warp.pixels(centre2d - half), warp.pixels(centre2d + half)], axis=1)
    centre3d_px = warp.pixels(centre2d + at["amodel_offset"])
    with np.errstate(invalid="ignore", over="ignore"):
        position, azimuth_rad = _place(camera, centre3d_px, _depths_m(at["dep"][:, 0], warp.scale, camera))
        yaw_rad = normalise_angle(azimuth_rad - np.pi / 2 - _alphas_rad(at["rot"]))
    boxes = np.concatenate([position, at["dim"][:, [2, 1, 0]], yaw_rad[:, None]], axis=1)
    kinds = np.array([kind.number for kind in VEHICLES.values()])
    found = Decoded(boxes, boxes2d, kinds[peaks.classes.numpy()], peaks.scores.double().numpy())
    possible = np.flatnonzero(np.isfinite(np.hstack([boxes, boxes2d])).all(axis=1) & (boxes[:, 3:6] > 0).all(axis=1))
    kept = possible[distinct(boxes2d[possible])]
    return Decoded(found.boxes[kept], found.boxes2d[kept], found.classes[kept], found.scores[kept])


def _depths_m(raw: Array, scale: float, camera: Camera) -> Array:
    """(N,) depths along the optical axis.

    The network sees only how large a thing is in its input. The same size means a depth in proportion to the focal
    length there.
    """
    focal_px = scale * float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    inverse = 1.0 / (1.0 + np.exp(-np.clip(raw, -50.0, 50.0)))
    return np.asarray((1.0 / (inverse + 1e-6) - 1.0) * focal_px / TRAINED_FOCAL_PX)


def _place(camera: Camera, pixels: Array, depths_m: Array) -> tuple[Array, Array]:
    """World points (N, 3) at the depths (N,) on the rays through pixels (N, 2), and the rays' azimuths (N,)."""
    directions = camera.rays(pixels)
    along_axis = directions @ camera.T_world_cam.rotation[:, 2]
    points = camera.centre_m + directions * (depths_m / along_axis)[:, None]
    return points, np.arctan2(directions[:, 1], directions[:, 0])


def _alphas_rad(rot: Array) -> Array:
    """(N,) alpha of the more probable of two bins, from (N, 8): per bin two logits, sin and cos.

    Alpha turns clockwise, seen from above, from "heads right across the line of sight". Added to the ray's angle in a
    level camera it gives the published rotation about the camera's y axis. Taken from the azimuth of the world ray it
    gives the yaw in the world, whatever the camera's pitch and roll.
    """
    first = np.arctan2(rot[:, 2], rot[:, 3]) - np.pi / 2
    second = np.arctan2(rot[:, 6], rot[:, 7]) + np.pi / 2
    return np.where(rot[:, 1] > rot[:, 5], first, second)


def predict_vehicles(
    network: DLA34, frames: Iterable[Frame], *, min_score: float, long_side_px: int = LONG_SIDE_PX
) -> Iterator[Vehicles3D]:
    """Detect vehicles: one `Vehicles3D` in the world per frame, in the frames' order; standard deviations unknown.

    Args:
        network: on the CPU; put into evaluation mode while it runs.
        frames: consumed one at a time.
        min_score: peaks below it are left out.
        long_side_px: of the input.
    """
    for frame in frames:
        height_px, width_px = frame.image.shape[:2]
        warp = InputWarp.of(width_px, height_px, long_side_px)
        network.eval()
        with torch.inference_mode():
            heads = network(warp.to_input(frame.image))
            found = decode_vehicles(heads, warp, frame.camera.resized(width_px, height_px), min_score)
        yield Vehicles3D.of(
            frame.time_ns, found.boxes, classes=found.classes, scores=found.scores, camera_id=frame.camera_id
        )
