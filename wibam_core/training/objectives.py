"""The ways to learn from multi-view boxes, as losses of a batch of views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.config import FinetuneConfig
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.models.decode import Decode, boxes3d, gather
from wibam_core.models.inference import prepare_camera
from wibam_core.models.small import INPUT_WIDTH_PX, SmallOutputs
from wibam_core.scene import CameraRig
from wibam_core.training.augment import mirror_camera
from wibam_core.training.dataset import SiteView
from wibam_core.training.losses import LossWeights, box2d_loss, focal_loss, lifted_loss
from wibam_core.training.multiview import OtherViews, multiview_loss
from wibam_core.training.targets import Targets
from wibam_core.training.views import FloatArray

#: Of the multi-view loss beside the lifted one. Small, because it gained nothing on top of lifted labels where it was
#: measured, and its pull towards smaller sizes is the published method's known fault.
DEFAULT_MULTIVIEW_WEIGHT = 0.1

#: Headings and sizes are what a box's place is fitted by, and small numbers beside offsets in cells.
_LIFTED_WEIGHTS = LossWeights(yaw=4.0, size=3.0)


@dataclass(frozen=True)
class LiftedObjective:
    """Learn from the fits to all views: `wibam_core.training.losses.lifted_loss`."""

    decode: Decode

    def __call__(
        self, outputs: SmallOutputs, targets: Targets, mean_sizes_m: Tensor, others: OtherViews
    ) -> dict[str, Tensor]:
        return lifted_loss(outputs, targets, mean_sizes_m, _LIFTED_WEIGHTS, self.decode)


@dataclass(frozen=True)
class PaperObjective:
    """The published loss (Howe et al. 2021, eq. 1): the focal loss of the centres plus the multi-view loss.

    Attributes:
        decode: how boxes are placed along the ray.
        box_heads: also learn the centre offset and the size of the 2D boxes by L1, as the published code does; weighted
            as in the lifted loss.
    """

    decode: Decode
    box_heads: bool = False

    def __call__(
        self, outputs: SmallOutputs, targets: Targets, mean_sizes_m: Tensor, others: OtherViews
    ) -> dict[str, Tensor]:
        parts = {
            "heat": focal_loss(outputs.heat, targets.heat, targets.judged).double(),
            "multiview": _multiview(outputs, targets, mean_sizes_m, others, self.decode),
        }
        if self.box_heads:
            values = gather(outputs, targets.image, targets.cells, targets.classes)
            parts["box2d"] = _LIFTED_WEIGHTS.box2d * box2d_loss(values, targets)
        return {**parts, "total": torch.stack(list(parts.values())).sum()}


@dataclass(frozen=True)
class CombinedObjective:
    """The lifted loss plus ``multiview_weight`` times the multi-view loss."""

    decode: Decode
    multiview_weight: float

    def __call__(
        self, outputs: SmallOutputs, targets: Targets, mean_sizes_m: Tensor, others: OtherViews
    ) -> dict[str, Tensor]:
        lifted = lifted_loss(outputs, targets, mean_sizes_m, _LIFTED_WEIGHTS, self.decode)
        multiview = self.multiview_weight * _multiview(outputs, targets, mean_sizes_m, others, self.decode)
        return {**lifted, "multiview": multiview, "total": lifted["total"] + multiview}


Objective = LiftedObjective | PaperObjective | CombinedObjective


def objective_of(config: FinetuneConfig) -> Objective:
    """The loss that the options ask for."""
    if config.method == "lifted":
        return LiftedObjective(config.decode)
    if config.method == "paper":
        return PaperObjective(config.decode, config.box_heads)
    weight = DEFAULT_MULTIVIEW_WEIGHT if config.multiview_weight is None else config.multiview_weight
    return CombinedObjective(config.decode, weight)


def _multiview(
    outputs: SmallOutputs, targets: Targets, mean_sizes_m: Tensor, others: OtherViews, decode: Decode
) -> Tensor:
    """The multi-view loss of the boxes that the heads give at the centres of the vehicles' automatic boxes."""
    rows = targets.centre.nonzero()[:, 0]
    values = gather(outputs, targets.image[rows], targets.cells[rows], targets.classes[rows])
    boxes = boxes3d(values, targets.cameras, mean_sizes_m, decode)
    known = torch.cat([targets.vehicle[rows], others.vehicle])
    row_of_vehicle = torch.full((int(known.max()) + 1 if len(known) else 0,), -1, device=rows.device)
    row_of_vehicle[targets.vehicle[rows]] = torch.arange(len(rows), device=rows.device)
    row = row_of_vehicle[others.vehicle]
    seen = row >= 0
    return multiview_loss(boxes, OtherViews(row[seen], others.camera[seen], others.boxes[seen], others.cameras))


class OtherCameras:
    """Turns the other views of site views into `OtherViews`, mirrored where the view is.

    Args:
        rig: cameras, of the recording's pixels.
        own_view: whether the view that a box is predicted in counts as one of the views that it must fit, as in the
            published code. It does so for the vehicles that another view sees too.
        input_width_px: how wide the network sees the images.
    """

    def __init__(self, rig: CameraRig, own_view: bool = False, input_width_px: int = INPUT_WIDTH_PX) -> None:
        prepared = [prepare_camera(camera, input_width_px) for camera in rig.values()]
        self._own_view = own_view
        self._number_of = {camera_id: number for number, camera_id in enumerate(rig)}
        self._widths = np.array([camera.width_px for camera in prepared])
        self._cameras = CameraTensors.from_cameras(
            [*prepared, *(mirror_camera(camera) for camera in prepared)], torch.float64
        )

    def of(self, views: Sequence[SiteView], mirrored: Sequence[bool]) -> OtherViews:
        """For a batch in which the vehicles of the views are numbered one view after the other."""
        vehicle: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
        camera: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
        boxes: list[FloatArray] = [np.zeros((0, 4))]
        first = 0
        for view, is_mirrored in zip(views, mirrored, strict=True):
            vehicles, cameras, given = self._pairs(view)
            vehicle.append(vehicles + first)
            camera.append(cameras + (len(self._widths) if is_mirrored else 0))
            boxes.append(_mirror(given, self._widths[cameras]) if is_mirrored else given)
            first += len(view.labels.classes)
        return OtherViews(
            torch.from_numpy(np.concatenate(vehicle)),
            torch.from_numpy(np.concatenate(camera)),
            torch.from_numpy(np.concatenate(boxes)),
            self._cameras,
        )

    def _pairs(self, view: SiteView) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
        """Vehicles (P,) of the view, cameras (P,) and boxes (P, 4), px of the camera's input."""
        if not self._own_view:
            return view.other_vehicle, view.other_camera, view.other_boxes
        vehicle = np.unique(view.other_vehicle)
        return (
            np.concatenate([view.other_vehicle, vehicle]),
            np.concatenate([view.other_camera, np.full(len(vehicle), self._number_of[view.camera_id])]),
            np.concatenate([view.other_boxes, view.labels.boxes2d[vehicle]]),
        )


def _mirror(boxes: FloatArray, width_px: NDArray[np.int64]) -> FloatArray:
    """Boxes (P, 4) in column-mirrored images of widths (P,)."""
    left, top, right, bottom = boxes.T
    return np.stack([width_px - 1 - right, top, width_px - 1 - left, bottom], axis=1)
