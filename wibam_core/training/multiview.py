"""The published loss (Howe et al. 2021, eq. 1): a box seen in one view must fit the 2D boxes of the other views.

The published code counts the view that the box is predicted in among them; here a pair of a vehicle and its own view
does that, see `wibam_core.training.objectives.OtherCameras`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from wibam_core.geometry.torch_ops import CameraTensors, corners, giou, tight_boxes, to_camera

#: A view is left out for a vehicle with any corner nearer to it than this: its projection would say little and its
#: gradient explode.
NEAR_M = 0.5


@dataclass(frozen=True, eq=False)
class OtherViews:
    """P pairs of a vehicle and a view of the same instant.

    Attributes:
        vehicle: (P,) which of the N vehicles. camera: (P,) which of the cameras.
        boxes: (P, 4) xyxy: the vehicle's 2D box in that view, px of the camera.
        cameras: (C,), of the dtype of the vehicles' boxes.
    """

    vehicle: Tensor
    camera: Tensor
    boxes: Tensor
    cameras: CameraTensors


def multiview_loss(boxes: Tensor, views: OtherViews) -> Tensor:
    """Mean over vehicles of the mean over their views of 1 − GIoU between reprojected and given 2D boxes.

    Boxes (N, 7) are in the world. Reprojections are clamped at the image border, as a detector's boxes are. Vehicles
    without a usable view do not count; with none at all the loss is 0. A box that is not finite makes the loss NaN: it
    lies in no view, and would else be passed over in silence.
    """
    if not bool(boxes.isfinite().all()):
        return boxes.sum() * torch.nan
    cameras = views.cameras[views.camera]
    paired = boxes[views.vehicle]
    usable = to_camera(cameras, corners(paired))[..., 2].amin(dim=-1) >= NEAR_M
    cameras, paired, given = cameras[usable], paired[usable], views.boxes[usable]
    vehicle = views.vehicle[usable]
    projected, in_view = tight_boxes(cameras, paired)
    loss = torch.where(in_view, 1 - giou(projected, given), torch.zeros_like(given[:, 0]))
    zeros = boxes.new_zeros(len(boxes))
    total = zeros.index_add(0, vehicle, loss)
    count = zeros.index_add(0, vehicle, in_view.to(boxes.dtype))
    seen = count > 0
    return (total / count.clamp_min(1)).sum() / seen.sum().clamp_min(1)
