"""What the small network should say about labelled views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.geometry.box3d import HEIGHT, SIZE, XYZ, YAW
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.pixels import resized_px
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.models.frames import INPUT_WIDTH_PX
from wibam_core.models.trunk import STRIDE
from wibam_core.networks.small.architecture import MEAN_SIZES_M, REFERENCE_FOCAL_PX
from wibam_core.networks.small.decode import TAUGHT_CELLS
from wibam_core.training.views import FloatArray, LabelledView

#: A projected 3D centre farther than this from the 2D box's centre belongs to a truncated vehicle, whose visible part
#: does not tell where its centre is; left in, such vehicles dominate the loss. In images wider than `INPUT_WIDTH_PX` it
#: may be as many times farther.
MAX_CENTRE_OFFSET_CELLS = 14.0

#: Standard deviation of a heat peak, as a share of the 2D box's side (Liu et al. 2020, TTFNet: 0.54 / 6).
_SIGMA_SHARE = 0.09

_MEAN_SIZES = np.array(MEAN_SIZES_M)


@dataclass(frozen=True, eq=False)
class Targets:
    """Targets of a batch of B views with N taught cells.

    Attributes:
        heat: (B, C, h, w) in [0, 1]. judged: (B, 1, h, w), 0 where the heat is not judged.
        image: (N,). cells: (N, 2) x, y. classes: (N,). vehicle: (N,) index of the vehicle in the batch.
        centre: (N,) whether the cell is its vehicle's peak, not a neighbour of it.
        box2d: (N, 4) as the head. lifted: (N,) weight of the 3D values, 0 where there are none.
        centre3d: (N, 2), depth: (N,), size: (N, 3), yaw: (N, 2) unit sin, cos, footprint: (N, 2): as the heads;
            float32.
        front_known: (N,) whether yaw tells front from rear.
        boxes3d: (N, 7) in the world, float64. cameras: (B,), float64.
    """

    heat: Tensor
    judged: Tensor
    image: Tensor
    cells: Tensor
    classes: Tensor
    vehicle: Tensor
    centre: Tensor
    box2d: Tensor
    lifted: Tensor
    centre3d: Tensor
    depth: Tensor
    size: Tensor
    yaw: Tensor
    footprint: Tensor
    front_known: Tensor
    boxes3d: Tensor
    cameras: CameraTensors

    def to(self, device: torch.device) -> Targets:
        """The same on another device."""
        return Targets(**{name: value.to(device) for name, value in vars(self).items()})


def encode(views: Sequence[LabelledView], mean_sizes_m: FloatArray = _MEAN_SIZES) -> Targets:
    """Targets for views of equal image size.

    Args:
        views: their ``classes`` are channels of the heat.
        mean_sizes_m: (C, 3) mean length, width and height of each class.
    """
    height, width = (side // STRIDE for side in views[0].image.shape[:2])
    heat = np.zeros((len(views), len(mean_sizes_m), height, width), np.float32)
    judged = np.ones((len(views), 1, height, width), np.float32)
    rows: list[dict[str, NDArray]] = []
    vehicles = 0
    for index, view in enumerate(views):
        _draw_ignored(judged[index, 0], view.ignored)
        for box, vehicle_class in zip(view.boxes2d, view.classes, strict=True):
            _draw_peak(heat[index, vehicle_class], box)
        rows.append(_taught_cells(view, index, vehicles, width, height, mean_sizes_m))
        vehicles += len(view.classes)
    judged[heat.max(axis=1, keepdims=True) >= 1.0] = 1.0
    joined = {name: torch.from_numpy(np.concatenate([row[name] for row in rows])) for name in rows[0]}
    cameras = CameraTensors.from_cameras([view.camera for view in views], torch.float64)
    return Targets(torch.from_numpy(heat), torch.from_numpy(judged), cameras=cameras, **joined)


def _draw_peak(heat: NDArray[np.float32], box: FloatArray) -> None:
    """A Gaussian around the box's centre cell, the highest of old and new."""
    x, y = _centre_cells(box[None])[0]
    sigma = np.maximum((box[2:] - box[:2]) / STRIDE * _SIGMA_SHARE, 0.55)
    reach = np.ceil(3 * sigma).astype(int)
    x0, x1 = max(x - reach[0], 0), min(x + reach[0] + 1, heat.shape[1])
    y0, y1 = max(y - reach[1], 0), min(y + reach[1] + 1, heat.shape[0])
    if x0 >= x1 or y0 >= y1:
        return
    across = np.exp(-0.5 * ((np.arange(x0, x1) - x) / sigma[0]) ** 2)
    down = np.exp(-0.5 * ((np.arange(y0, y1) - y) / sigma[1]) ** 2)
    patch = heat[y0:y1, x0:x1]
    np.maximum(patch, (down[:, None] * across).astype(np.float32), out=patch)


def _draw_ignored(judged: NDArray[np.float32], boxes: FloatArray) -> None:
    for x0, y0, x1, y1 in np.rint((boxes + 0.5) / STRIDE).astype(int):
        judged[max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)] = 0.0


def _centre_cells(boxes: FloatArray) -> NDArray[np.int64]:
    """(N, 2) x, y of the cells that hold the boxes' centres."""
    centres = (boxes[:, :2] + boxes[:, 2:]) / 2
    return np.floor((centres + 0.5) / STRIDE).astype(np.int64)


def _taught_cells(
    view: LabelledView, image: int, first_vehicle: int, width: int, height: int, mean_sizes_m: FloatArray
) -> dict[str, NDArray]:
    n, k = len(view.classes), len(TAUGHT_CELLS)
    vehicle = np.repeat(np.arange(n), k)
    cells = (_centre_cells(view.boxes2d)[:, None] + np.array(TAUGHT_CELLS)).reshape(-1, 2)
    inside = ((cells >= 0) & (cells < [width, height])).all(axis=1)
    is_centre = np.tile(np.arange(k) == 0, n)[inside]
    vehicle, cells = vehicle[inside], cells[inside]
    boxes2d, classes = view.boxes2d[vehicle], view.classes[vehicle]
    side = np.maximum(boxes2d[:, 2:] - boxes2d[:, :2], 1.0) / STRIDE
    centre = resized_px((boxes2d[:, :2] + boxes2d[:, 2:]) / 2, 1 / STRIDE)
    lifted, values = _lifted_values(view, vehicle, cells, centre, mean_sizes_m[view.classes])
    return {
        "image": np.full(len(vehicle), image, np.int64),
        "cells": cells,
        "classes": classes,
        "vehicle": vehicle + first_vehicle,
        "centre": is_centre,
        "box2d": np.concatenate([centre - cells, np.log(side)], axis=1).astype(np.float32),
        "lifted": lifted.astype(np.float32),
        **values,
    }


def _lifted_values(
    view: LabelledView,
    vehicle: NDArray[np.int64],
    cells: NDArray[np.int64],
    centre: FloatArray,
    usual_sizes_m: FloatArray,
) -> tuple[FloatArray, dict[str, NDArray]]:
    """The weights (N,) of the 3D values of the taught cells, and the values; weight 0 where they do not exist.

    ``usual_sizes_m`` (V, 3) are the mean sizes of the classes of the view's vehicles.
    """
    known = np.isfinite(view.boxes3d.sum(axis=1))
    boxes = np.where(known[:, None], view.boxes3d, [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0])
    uv, depth = view.camera.project(boxes[:, XYZ])
    ground, ground_depth = view.camera.project(boxes[:, XYZ] - boxes[:, HEIGHT, None] / 2 * [0.0, 0.0, 1.0])
    known &= np.minimum(depth, ground_depth) > 0.5
    uv, ground = (np.where(known[:, None], pixels, 0.0) for pixels in (uv, ground))
    centre3d, footprint = (resized_px(pixels, 1 / STRIDE)[vehicle] for pixels in (uv, ground))
    farthest = MAX_CENTRE_OFFSET_CELLS * max(1.0, (view.whole_width_px or view.camera.width_px) / INPUT_WIDTH_PX)
    known_cell = known[vehicle] & (np.abs(centre3d - centre).max(axis=1, initial=0) <= farthest)
    rays = view.camera.rays(uv)
    alpha = boxes[:, YAW] - np.arctan2(rays[:, 1], rays[:, 0])
    virtual_depth = np.where(known, depth, 1.0) * REFERENCE_FOCAL_PX / _focal_px(view.camera)
    log_size = np.log(boxes[:, SIZE] / usual_sizes_m)
    weight = np.where(known_cell, view.confidence[vehicle], 0.0)
    return weight, {
        "centre3d": (centre3d - cells).astype(np.float32),
        "depth": np.log(virtual_depth)[vehicle].astype(np.float32),
        "size": log_size[vehicle].astype(np.float32),
        "yaw": np.stack([np.sin(alpha), np.cos(alpha)], axis=1)[vehicle].astype(np.float32),
        "footprint": (footprint - cells).astype(np.float32),
        "front_known": view.front_known[vehicle],
        "boxes3d": boxes[vehicle],
    }


def _focal_px(camera: Camera) -> float:
    """As `wibam_core.geometry.torch_ops.focal_px`, without making tensors of the camera."""
    return math.sqrt(camera.K[0, 0] * camera.K[1, 1])
