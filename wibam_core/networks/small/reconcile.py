"""One vehicle from all that the small network says about it.

The heads say the same thing several times over: where the footprint is seen, where the 3D centre, how far away it is,
how large the vehicle is and which way it points; and then the edges of its 2D box follow from its place, size and
heading, by the class's body. They err differently. A few Gauss-Newton steps give the box on the ground that agrees best
with them all, each by its stated uncertainty.
"""

from __future__ import annotations

import torch
from torch import Tensor

from wibam_core.geometry.box3d import SIZE, XY, XYZ, YAW
from wibam_core.geometry.gauss_newton import cauchy_weights, newton_steps, normal_equations
from wibam_core.geometry.occlusion import hidden_edges, stands_before
from wibam_core.geometry.torch_ops import CameraTensors, focal_px, project, vehicle_to_world, wrap_angle
from wibam_core.models.second_look import Edges
from wibam_core.models.trunk import STRIDE
from wibam_core.networks.small.architecture import REFERENCE_FOCAL_PX, UNCERTAINTY_GROUPS
from wibam_core.networks.small.decode import PeakValues, boxes2d_px, centres3d_px, deviations, footprints_px

#: How far an edge of the regressed 2D box lies off the body's (standard deviation): px, and share of the box's side,
#: added in squares.
_EDGE_SD_PX, _EDGE_SD_SHARE = 0.7, 0.03
#: The same of an edge of a second look, added to what that states itself: no vehicle has quite the body of its class.
_BODY_SD_PX = 0.3
#: Headings count as if they erred this many times less than the network says, since the edges of 2D boxes would turn
#: vehicles otherwise: the first number beside those, the second beside edges of a second look, which err less.
_YAW_TRUST, _YAW_TRUST_BESIDE_EDGES = 2.0, 1.5
#: An edge nearer to the image's border than this may have been cut by it, px.
_BORDER_PX = 3.0
#: An edge of which a nearer vehicle's box covers more than this share may be hidden by it.
_HIDDEN_SHARE = 0.3
#: A vehicle stands nearer than another if its box reaches at least so much farther down, px; edges up to so much beyond
#: its box may be hidden by it, px.
_LOWER_PX, _SLACK_PX = 1.0, 2.0
#: Residuals beyond this many standard deviations count less and less.
_ROBUST_SD = 3.0
#: Gauss-Newton steps: fits start close to where they end.
_STEPS = 4
#: A fit that moves a box farther than this is given up: m over the ground, log of a size, rad.
_FARTHEST_M, _FARTHEST_LOG_SIZE, _FARTHEST_RAD = 3.0, 0.5, 0.5
#: No edge is compared of a vehicle with a body point nearer than this along the optical axis, m.
_NEAREST_M = 0.5

#: Steps, to either side, over which derivatives are differences: in x, y (m), log length, width and height, yaw (rad).
_DELTAS = (0.05, 0.05, 0.01, 0.01, 0.01, 0.01)
_PLACE, _LOG_SIZE, _TURN = slice(0, 2), slice(2, 5), slice(5, 6)
_CENTRE, _DEPTH, _SIZE, _YAW, _FOOTPRINT = map(
    UNCERTAINTY_GROUPS.index, ("centre3d", "depth", "size", "yaw", "footprint")
)


def reconciled(
    values: PeakValues,
    boxes: Tensor,
    sd: Tensor,
    cameras: CameraTensors,
    bodies: Tensor,
    edges: Edges | None = None,
) -> tuple[Tensor, Tensor]:
    """Boxes (N, 7) that agree best with all heads, and their standard deviations (N, 7).

    Args:
        values: what the heads say, float64, without duplicates: they would count as what hides a vehicle.
        boxes: (N, 7) on the ground, where the fits start; one whose fit leads nowhere stays as it is.
        sd: (N, 7) their standard deviations, kept with them.
        cameras: (B,) of the batch, float64, at the network's input size.
        bodies: (N, P, 3) of their classes, see `wibam_core.road_users.BODIES`.
        edges: of the whole vehicles, px of the network's input, instead of those of the regressed 2D boxes.

    All are on the CPU.
    """
    if not len(boxes):
        return boxes, sd
    problem = _Problem(values, boxes, cameras, bodies, edges)
    parameters = torch.cat([boxes[:, XY], boxes[:, SIZE].log(), boxes[:, YAW, None]], dim=1)
    for _ in range(_STEPS):
        information, gradient = problem.normal_equations(parameters)
        parameters = parameters + newton_steps(information, gradient)
    variance = torch.linalg.inv_ex(information)[0].diagonal(dim1=-2, dim2=-1)
    found, own = _boxes(parameters), variance.clamp_min(0.0).sqrt()
    size_sd = found[:, SIZE] * own[:, _LOG_SIZE]
    yaw_sd = (problem.yaw_trust * own[:, _TURN]).clamp(max=torch.pi)
    found_sd = torch.cat([own[:, _PLACE], size_sd[:, 2:] / 2, size_sd, yaw_sd], dim=1)
    good = (variance > 0).all(dim=1) & found.isfinite().all(dim=1)
    good &= torch.linalg.norm((found - boxes)[:, XY], dim=1) <= _FARTHEST_M
    good &= (found / boxes)[:, SIZE].log().abs().amax(dim=1) <= _FARTHEST_LOG_SIZE
    good &= wrap_angle(found[:, YAW] - boxes[:, YAW]).abs() <= _FARTHEST_RAD
    return torch.where(good[:, None], found, boxes), torch.where(good[:, None], found_sd, sd)


def _boxes(parameters: Tensor) -> Tensor:
    """Boxes (..., 7) of parameters (..., 6)."""
    size = parameters[..., _LOG_SIZE].exp()
    return torch.cat([parameters[..., _PLACE], size[..., 2:] / 2, size, wrap_angle(parameters[..., _TURN])], dim=-1)


class _Problem:
    """Residuals of N vehicles in standard deviations: four edges, footprint, 3D centre, depth, size and heading.

    Attributes:
        yaw_trust: headings are taken to err so many times less than they say.
    """

    def __init__(
        self, values: PeakValues, boxes: Tensor, cameras: CameraTensors, bodies: Tensor, edges: Edges | None
    ) -> None:
        self._seen_by = cameras[values.image]
        self._bodies = bodies
        outline, depths = self._outline(boxes[:, None])
        self.yaw_trust = _YAW_TRUST if edges is None else _YAW_TRUST_BESIDE_EDGES
        if edges is None:
            px = boxes2d_px(values)
            sd_px = _EDGE_SD_PX + _EDGE_SD_SHARE * (px[:, 2:] - px[:, :2]).repeat(1, 2)
            told = ~covered_edges(px, values.image)
        else:
            px, sd_px = edges.px, (edges.sd_px.square() + _BODY_SD_PX**2).sqrt()
            told = torch.ones_like(px, dtype=torch.bool)
        told &= edges_within(px, outline[:, 0], self._seen_by.size)
        told &= (depths[:, 0].amin(dim=1) > _NEAREST_M)[:, None]
        self._edges, self._edge_weight = px[:, None], (told / sd_px)[:, None]  # with a dimension for the guesses
        self._footprint, self._centre = footprints_px(values)[:, None], centres3d_px(values)[:, None]
        self._log_depth, self._focal_px = values.depth[:, None, None], focal_px(self._seen_by)[:, None, None]
        self._log_size, self._yaw = boxes[:, None, SIZE].log(), boxes[:, None, YAW, None]
        self._weight = 1 / deviations(values)[:, None]

    def normal_equations(self, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 6, 6) information and (N, 6) gradient."""
        deltas = torch.diag(torch.tensor(_DELTAS, dtype=parameters.dtype))
        tried = torch.cat([torch.zeros_like(deltas[:1]), deltas, -deltas])
        residuals, ahead, behind = self._residuals(parameters[:, None] + tried).split([1, 6, 6], dim=1)
        jacobian = ((ahead - behind) / (2 * deltas.sum(dim=1)[:, None])).transpose(1, 2)
        residuals = residuals[:, 0]
        information, gradient = normal_equations(jacobian, residuals, cauchy_weights(residuals, _ROBUST_SD))
        return information + 1e-6 * torch.eye(len(_DELTAS), dtype=parameters.dtype), gradient

    def _outline(self, boxes: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels (N, K, P, 2) and depths (N, K, P) of the points of the bodies of boxes (N, K, 7)."""
        return project(self._seen_by, vehicle_to_world(boxes, self._bodies[:, None] * boxes[..., None, SIZE]))

    def _residuals(self, parameters: Tensor) -> Tensor:
        """(N, K, 13) of K guesses (N, K, 6) at the parameters of each vehicle."""
        boxes, log_size, yaw = _boxes(parameters), parameters[..., _LOG_SIZE], parameters[..., _TURN]
        outline, _ = self._outline(boxes)
        edges = torch.cat([outline.amin(dim=-2), outline.amax(dim=-2)], dim=-1)
        centre = boxes[..., XYZ]
        footprint = centre * torch.tensor([1.0, 1.0, 0.0], dtype=centre.dtype)
        pixels, depths = project(self._seen_by, torch.stack([footprint, centre], dim=-2))
        log_depth = (depths[..., -1:].clamp_min(0.1) * REFERENCE_FOCAL_PX / self._focal_px).log()
        weight = self._weight
        return torch.cat(
            [
                (edges - self._edges) * self._edge_weight,
                (pixels[..., -2, :] - self._footprint) / STRIDE * weight[..., [_FOOTPRINT]],
                (pixels[..., -1, :] - self._centre) / STRIDE * weight[..., [_CENTRE]],
                (log_depth - self._log_depth) * weight[..., [_DEPTH]],
                (log_size - self._log_size) * weight[..., [_SIZE]],
                self.yaw_trust * wrap_angle(yaw - self._yaw) * weight[..., [_YAW]],
            ],
            dim=-1,
        )


def edges_within(boxes: Tensor, outline: Tensor, size_px: Tensor) -> Tensor:
    """(N, 4) which edges, left, top, right, bottom, of 2D boxes (N, 4) xyxy are the vehicle's, not the image's border.

    Where the border cuts a vehicle, the point that makes another of its edges may be out of the image, too.

    Args:
        boxes: px.
        outline: (N, P, 2) about where the points of its body are seen, px.
        size_px: (N, 2) width and height of its image.
    """
    inside = torch.cat([boxes[:, :2] > _BORDER_PX, boxes[:, 2:] < size_px - 1 - _BORDER_PX], dim=1)
    # the other coordinate of the point that makes each edge: y of left and right, x of top and bottom
    makes = torch.cat([outline.argmin(dim=1), outline.argmax(dim=1)], dim=1)
    across = outline[torch.arange(len(boxes))[:, None], makes, torch.tensor([1, 0, 1, 0])]
    there = (across > -0.5) & (across < size_px.flip(-1).repeat(1, 2) - 0.5)
    return inside & (there | inside.all(dim=1, keepdim=True))


def covered_edges(boxes: Tensor, image: Tensor) -> Tensor:
    """(N, 4) which edges, left, top, right, bottom, of 2D boxes (N, 4) xyxy may be those of what hides the vehicle.

    That is a vehicle that stands nearer in the same image, which is one whose box reaches farther down.

    Args:
        boxes: of what is seen of the vehicles, px.
        image: (N,) which image each is in.
    """
    px = boxes.numpy()
    before = stands_before(-px[:, 3], _LOWER_PX) & (image[:, None] == image).numpy()
    return torch.from_numpy(hidden_edges(px, before, _HIDDEN_SHARE, px, _SLACK_PX))
