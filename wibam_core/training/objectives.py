"""The two ways to learn from multi-view boxes, as losses of a batch of views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.models.decode import Decode, boxes3d, gather
from wibam_core.models.inference import prepare_camera
from wibam_core.models.small import SmallOutputs
from wibam_core.scene import CameraRig
from wibam_core.training.augment import mirror_camera
from wibam_core.training.dataset import SiteView
from wibam_core.training.losses import LossWeights, focal_loss, lifted_loss
from wibam_core.training.multiview import OtherViews, multiview_loss
from wibam_core.training.targets import Targets

_LIFTED_WEIGHTS = LossWeights()


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

    A vehicle's prediction is what the heads say at the centre of its automatic box in the one view.
    """

    decode: Decode

    def __call__(
        self, outputs: SmallOutputs, targets: Targets, mean_sizes_m: Tensor, others: OtherViews
    ) -> dict[str, Tensor]:
        rows = targets.centre.nonzero()[:, 0]
        values = gather(outputs, targets.image[rows], targets.cells[rows], targets.classes[rows])
        boxes = boxes3d(values, targets.cameras, mean_sizes_m, self.decode)
        row_of_vehicle = torch.full((int(others.vehicle.max()) + 1 if len(others.vehicle) else 0,), -1)
        known = targets.vehicle[rows] < len(row_of_vehicle)
        row_of_vehicle[targets.vehicle[rows][known]] = torch.arange(len(rows))[known]
        row = row_of_vehicle[others.vehicle]
        seen = row >= 0
        views = OtherViews(row[seen], others.camera[seen], others.boxes[seen], others.cameras)
        heat = focal_loss(outputs.heat, targets.heat, targets.judged).double()
        multiview = multiview_loss(boxes, views)
        return {"heat": heat, "multiview": multiview, "total": heat + multiview}


Objective = LiftedObjective | PaperObjective


class OtherCameras:
    """Turns the other views of site views into `OtherViews`, mirrored where the view is."""

    def __init__(self, rig: CameraRig) -> None:
        prepared = [prepare_camera(camera) for camera in rig.values()]
        self._count = len(prepared)
        self._widths = np.array([camera.width_px for camera in prepared])
        self._cameras = CameraTensors.from_cameras(
            [*prepared, *(mirror_camera(camera) for camera in prepared)], torch.float64
        )

    def of(self, views: Sequence[SiteView], mirrored: Sequence[bool]) -> OtherViews:
        """For a batch in which the vehicles of the views are numbered one view after the other."""
        vehicle: list[np.ndarray] = []
        camera: list[np.ndarray] = []
        boxes: list[np.ndarray] = []
        first = 0
        for view, is_mirrored in zip(views, mirrored, strict=True):
            vehicle.append(view.other_vehicle + first)
            camera.append(view.other_camera + (self._count if is_mirrored else 0))
            boxes.append(self._mirror(view) if is_mirrored else view.other_boxes)
            first += len(view.labels.classes)
        return OtherViews(
            torch.from_numpy(np.concatenate(vehicle)),
            torch.from_numpy(np.concatenate(camera)),
            torch.from_numpy(np.concatenate(boxes)),
            self._cameras,
        )

    def _mirror(self, view: SiteView) -> np.ndarray:
        width = self._widths[view.other_camera]
        left, top, right, bottom = view.other_boxes.T
        return np.stack([width - 1 - right, top, width - 1 - left, bottom], axis=1)
