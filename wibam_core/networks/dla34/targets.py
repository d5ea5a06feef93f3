"""What DLA-34 should say about labelled views, in CenterTrack's terms (see `wibam_core.networks.dla34.centertrack`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.geometry.box3d import XYZ, YAW
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.networks.dla34.architecture import STRIDE
from wibam_core.networks.dla34.classes import RoadUserChannels
from wibam_core.road_users import CLASSES
from wibam_core.training.views import FloatArray, LabelledView

#: A projected 3D centre farther than this from the 2D box's centre belongs to a truncated vehicle, whose visible part
#: does not tell where its centre is: as far as for the small network, at this input's scale.
MAX_CENTRE_OFFSET_CELLS = 22.0

#: Peaks are so wide that a box about a cell within it still overlaps the vehicle's by this IoU (Law & Deng 2018).
_PEAK_IOU = 0.7

_NO_BOX = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class DLA34Targets:
    """Targets of a batch of B views with N vehicles whose centre is in the image.

    Attributes:
        heat: (B, K, h, w) in [0, 1], for the channels that find road users. judged: (B, 1, h, w), 0 where the heat is
            not judged. asked: (B, K, 1, 1), 0 for channels of road users that nobody looked for in the view.
        image: (N,). cells: (N, 2) x, y. vehicle: (N,) index of the vehicle in the batch.
        centre2d, wh: (N, 2) of the 2D box, cells.
        lifted: (N,) weight of what follows, 0 where it is unknown.
        centre3d: (N, 2) the projected 3D centre, cells. depth_m: (N,) along the optical axis. alpha_rad: (N,), see
            `wibam_core.networks.dla34.centertrack.alphas_rad`. front_known: (N,) whether it tells front from rear.
        boxes3d: (N, 7) in the world. cameras: (B,) of the inputs. All of these float64.
    """

    heat: Tensor
    judged: Tensor
    asked: Tensor
    image: Tensor
    cells: Tensor
    vehicle: Tensor
    centre2d: Tensor
    wh: Tensor
    lifted: Tensor
    centre3d: Tensor
    depth_m: Tensor
    alpha_rad: Tensor
    front_known: Tensor
    boxes3d: Tensor
    cameras: CameraTensors


def encode(views: Sequence[LabelledView], height: int, width: int, classes: RoadUserChannels) -> DLA34Targets:
    """Targets for views of known road users whose maps have the given size, cells."""
    heat = np.zeros((len(views), len(classes.channels), height, width), np.float32)
    judged = np.ones((len(views), 1, height, width), np.float32)
    asked = np.zeros((len(views), len(classes.channels), 1, 1), np.float32)
    rows: list[dict[str, NDArray]] = []
    vehicles = 0
    for index, view in enumerate(views):
        for x0, y0, x1, y1 in np.rint(view.ignored / STRIDE).astype(int):
            judged[index, 0, max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)] = 0.0
        asked[index, :, 0, 0] = [CLASSES[number] not in view.not_looked_for for number in classes.numbers]
        taught = _taught(view, height, width)
        for vehicle, cell, wh in zip(taught["vehicle"], taught["cells"], taught["wh"], strict=True):
            _draw_peak(heat[index, classes.row_of[view.classes[vehicle]]], cell, wh)
        taught["vehicle"] = taught["vehicle"] + vehicles
        rows.append({"image": np.full(len(taught["cells"]), index, np.int64), **taught})
        vehicles += len(view.classes)
    judged[heat.max(axis=1, keepdims=True) >= 1.0] = 1.0
    joined = {name: torch.from_numpy(np.concatenate([row[name] for row in rows])) for name in rows[0]}
    cameras = CameraTensors.from_cameras([view.camera for view in views], torch.float64)
    maps = {"heat": heat, "judged": judged, "asked": asked}
    joined |= {name: torch.from_numpy(values) for name, values in maps.items()}
    return DLA34Targets(cameras=cameras, **joined)


def _taught(view: LabelledView, height: int, width: int) -> dict[str, NDArray]:
    centre2d = (view.boxes2d[:, :2] + view.boxes2d[:, 2:]) / (2 * STRIDE)
    cells = np.floor(centre2d).astype(np.int64)
    vehicle = np.flatnonzero(((cells >= 0) & (cells < [width, height])).all(axis=1))
    boxes2d = view.boxes2d[vehicle]
    return {
        "cells": cells[vehicle],
        "vehicle": vehicle,
        "centre2d": centre2d[vehicle],
        "wh": np.maximum(boxes2d[:, 2:] - boxes2d[:, :2], 1.0) / STRIDE,
        "front_known": view.front_known[vehicle],
        **_lifted(view.camera, view.boxes3d[vehicle], view.confidence[vehicle], centre2d[vehicle]),
    }


def _lifted(camera: Camera, boxes3d: FloatArray, confidence: FloatArray, centre2d: FloatArray) -> dict[str, NDArray]:
    known = np.isfinite(boxes3d.sum(axis=1))
    boxes = np.where(known[:, None], boxes3d, _NO_BOX)
    uv, depth_m = camera.project(boxes[:, XYZ])
    known &= depth_m > 0.5
    uv = np.where(known[:, None], uv, 0.0)
    centre3d = uv / STRIDE
    known &= np.abs(centre3d - centre2d).max(axis=1, initial=0) <= MAX_CENTRE_OFFSET_CELLS
    rays = camera.rays(uv)
    return {
        "lifted": np.where(known, confidence, 0.0),
        "centre3d": centre3d,
        "depth_m": depth_m,
        "alpha_rad": np.arctan2(rays[:, 1], rays[:, 0]) - np.pi / 2 - boxes[:, YAW],
        "boxes3d": boxes,
    }


def _draw_peak(heat: NDArray[np.float32], cell: NDArray[np.int64], wh: FloatArray) -> None:
    """A Gaussian around a cell x, y, the highest of old and new."""
    reach = int(_inset(wh))
    x, y = cell
    x0, y0 = max(x - reach, 0), max(y - reach, 0)
    patch = heat[y0 : y + reach + 1, x0 : x + reach + 1]
    rows, columns = np.indices(patch.shape)
    squared = (columns + x0 - x) ** 2 + (rows + y0 - y) ** 2
    np.maximum(patch, np.exp(-squared / (2 * ((2 * reach + 1) / 6) ** 2)).astype(np.float32), out=patch)


def _inset(wh: FloatArray) -> float:
    """By how much all sides of a box of this width and height may move inwards to leave `_PEAK_IOU` of it."""
    total = wh.sum()
    return float((total - np.sqrt(total**2 - 4 * (1 - _PEAK_IOU) * wh.prod())) / 4)
