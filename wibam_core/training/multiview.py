"""The published loss (Howe et al. 2021, eq. 1): a box seen in one view must fit the 2D boxes of the other views.

The published code counts the view that the box is predicted in among them; here a pair of a vehicle and its own view
does that, see `OtherCameras`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.geometry.box3d import EDGES
from wibam_core.geometry.projection import EDGE_SHARES
from wibam_core.geometry.torch_ops import CameraTensors, corners, giou, project_camera_points
from wibam_core.models.frames import INPUT_WIDTH_PX, prepare_camera
from wibam_core.scene import CameraRig
from wibam_core.training.augment import mirror_camera
from wibam_core.training.dataset import SiteView
from wibam_core.training.views import FloatArray

#: A view is left out for a vehicle with any corner nearer to it than this: its projection would say little and its
#: gradient explode.
NEAR_M = 0.5

#: Weight of the multi-view loss beside the lifted one. Small, because it gained nothing on top of pseudo-labels where
#: it was measured, and its pull towards smaller sizes is the published method's known fault.
DEFAULT_MULTIVIEW_WEIGHT = 0.1


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

    def of_vehicles(self, vehicles: Tensor) -> OtherViews:
        """The pairs of these vehicles (N,) alone, in which each is called by its place among them."""
        numbers = torch.cat([vehicles, self.vehicle])
        place_of = torch.full((int(numbers.max()) + 1 if len(numbers) else 0,), -1, device=vehicles.device)
        place_of[vehicles] = torch.arange(len(vehicles), device=vehicles.device)
        place = place_of[self.vehicle]
        paired = place >= 0
        return OtherViews(place[paired], self.camera[paired], self.boxes[paired], self.cameras)


def multiview_loss(boxes: Tensor, views: OtherViews) -> Tensor:
    """Mean over vehicles of the mean over their views of 1 − GIoU between reprojected and given 2D boxes.

    Boxes (N, 7) are in the world. Reprojections are clamped at the image border, as a detector's boxes are. Vehicles
    without a usable view do not count; with none at all the loss is 0. A box that is not finite makes the loss NaN: it
    lies in no view, and would else be passed over in silence.
    """
    if not bool(boxes.isfinite().all()):
        return boxes.sum() * torch.nan
    cameras = views.cameras[views.camera]
    points = corners(boxes)[views.vehicle] @ cameras.rotation.transpose(1, 2) + cameras.translation[:, None]
    usable = points.detach()[..., 2].amin(dim=1) >= NEAR_M
    vehicle, given = views.vehicle, views.boxes
    if not bool(usable.all()):
        cameras, points, vehicle, given = cameras[usable], points[usable], vehicle[usable], given[usable]
    projected, in_view = _outlines(cameras, points)
    loss = torch.where(in_view, 1 - giou(projected, given), torch.zeros_like(given[:, 0]))
    zeros = boxes.new_zeros(len(boxes))
    total = zeros.index_add(0, vehicle, loss)
    count = zeros.index_add(0, vehicle, in_view.to(boxes.dtype))
    seen = count > 0
    return (total / count.clamp_min(1)).sum() / seen.sum().clamp_min(1)


def _outlines(cameras: CameraTensors, points: Tensor) -> tuple[Tensor, Tensor]:
    """As `wibam_core.geometry.torch_ops.tight_boxes`, of corners (P, 8, 3) in front of their cameras (P,): none is cut.

    Where no lens bends edges their ends are all that counts.
    """
    if bool((cameras.dist != 0).any()):
        start, end = points[:, EDGES[:, 0].tolist()], points[:, EDGES[:, 1].tolist()]
        points = torch.cat([start + share * (end - start) for share in EDGE_SHARES[:-1].tolist()] + [end], dim=1)
    uv = project_camera_points(cameras, points)
    low, high, limits = uv.amin(dim=1), uv.amax(dim=1), cameras.size - 0.5
    in_view = ((low < limits) & (high > -0.5)).all(dim=1)
    bounds = torch.full_like(limits, -0.5), limits
    return torch.cat([low.clamp(*bounds), high.clamp(*bounds)], dim=1), in_view


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
            first += len(view.pseudo_labels.classes)
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
            np.concatenate([view.other_boxes, view.pseudo_labels.boxes2d[vehicle]]),
        )


def _mirror(boxes: FloatArray, width_px: NDArray[np.int64]) -> FloatArray:
    """Boxes (P, 4) in column-mirrored images of widths (P,)."""
    left, top, right, bottom = boxes.T
    return np.stack([width_px - 1 - right, top, width_px - 1 - left, bottom], axis=1)
