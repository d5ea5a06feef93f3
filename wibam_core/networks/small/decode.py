"""From output maps to boxes: differentiable, and the same code in losses and, but for `reconcile`, at inference.

Maps have a pixel frame of their own: cell (x, y) is centred on input pixel ``(x + 0.5)·4 − 0.5``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from wibam_core.geometry.box3d import HEIGHT, SIZE, XYZ
from wibam_core.geometry.torch_ops import CameraTensors, azimuths_rad, focal_px, rays, wrap_angle
from wibam_core.models.peaks import cell_centres_px
from wibam_core.models.trunk import STRIDE
from wibam_core.networks.small.architecture import REFERENCE_FOCAL_PX, UNCERTAINTY_GROUPS, SmallOutputs
from wibam_core.placing import Decode

#: Ways to place boxes that place the footprint's centre, not the 3D centre.
_BY_FOOTPRINT = ("ground", "fitted", "refined")


#: Steps x, y from a peak to the cells that are taught its vehicle: itself, which comes first, and its neighbours, since
#: inference may find the peak one cell off.
TAUGHT_CELLS = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))

#: Where the footprint's uncertainty stands among `UNCERTAINTY_GROUPS`.
_FOOTPRINT = UNCERTAINTY_GROUPS.index("footprint")

#: Rays less steep than this (m down per m) are taken as this steep when they are met with a plane: a ray along
#: the horizon meets it nowhere.
_MIN_DESCENT = 0.02


@dataclass(frozen=True)
class PeakValues:
    """What the heads say at N peaks, float64 but for the indices.

    Attributes:
        image: (N,) index in the batch. cells: (N, 2) x, y. classes: (N,).
        box2d: (N, 4) raw, centre3d: (N, 2) raw, depth: (N,) log depth at the reference focal length,
        size: (N, 3) log size against the class's mean, yaw: (N, 2) sin, cos, footprint: (N, 2) raw,
        log_scale: (N, 5): as `SmallOutputs`.
    """

    image: Tensor
    cells: Tensor
    classes: Tensor
    box2d: Tensor
    centre3d: Tensor
    depth: Tensor
    size: Tensor
    yaw: Tensor
    footprint: Tensor
    log_scale: Tensor

    def __getitem__(self, index: Tensor) -> PeakValues:
        """Some of the peaks."""
        return PeakValues(**{name: value[index] for name, value in vars(self).items()})


def gather(outputs: SmallOutputs, image: Tensor, cells: Tensor, classes: Tensor) -> PeakValues:
    """Read the heads at cells (N, 2) x, y of the images (N,)."""

    def at(values: Tensor) -> Tensor:
        return values[image, :, cells[:, 1], cells[:, 0]].double()

    return PeakValues(
        image,
        cells,
        classes,
        at(outputs.box2d),
        at(outputs.centre3d),
        at(outputs.depth)[:, 0],
        at(outputs.size),
        at(outputs.yaw),
        at(outputs.footprint),
        at(outputs.log_scale),
    )


def gather_around(outputs: SmallOutputs, image: Tensor, cells: Tensor, classes: Tensor) -> PeakValues:
    """As `gather`, but means over `TAUGHT_CELLS` about each peak, offsets as from the peak's own cell.

    The scales are those of the peak. Errors of the cells differ a little, so that their mean errs less.
    """
    height, width = outputs.heat.shape[2:]
    steps = torch.tensor(TAUGHT_CELLS, device=cells.device)
    around = cells[:, None] + steps
    inside = ((around >= 0) & (around < torch.tensor([width, height], device=cells.device))).all(dim=-1)
    steps = torch.where(inside[..., None], steps, 0)
    each = gather(
        outputs,
        image.repeat_interleave(len(TAUGHT_CELLS)),
        (cells[:, None] + steps).flatten(0, 1),
        classes.repeat_interleave(len(TAUGHT_CELLS)),
    )

    def mean(values: Tensor, offset: bool = False) -> Tensor:
        values = values.unflatten(0, (len(cells), len(TAUGHT_CELLS)))
        if offset:
            values = torch.cat([values[..., :2] + steps, values[..., 2:]], dim=-1)
        weight = inside.double().reshape(*inside.shape, *[1] * (values.dim() - 2))
        return (weight * values).sum(dim=1) / weight.sum(dim=1)

    return PeakValues(
        image,
        cells,
        classes,
        mean(each.box2d, offset=True),
        mean(each.centre3d, offset=True),
        mean(each.depth),
        mean(each.size),
        mean(each.yaw),
        mean(each.footprint, offset=True),
        each.log_scale[:: len(TAUGHT_CELLS)],
    )


def boxes2d_px(values: PeakValues) -> Tensor:
    """2D boxes (N, 4) xyxy, input px."""
    centre = cell_centres_px(values.cells + values.box2d[:, :2])
    half = values.box2d[:, 2:].clamp(max=6.0).exp() * (STRIDE / 2)
    return torch.cat([centre - half, centre + half], dim=-1)


def sizes_m(values: PeakValues, mean_sizes_m: Tensor) -> Tensor:
    """(N, 3) length, width, height, m; at most e times off the class's mean."""
    return mean_sizes_m.double()[values.classes] * values.size.clamp(-1.0, 1.0).exp()


def boxes3d(values: PeakValues, cameras: CameraTensors, mean_sizes_m: Tensor, decode: Decode) -> Tensor:
    """World boxes (N, 7) seen by the cameras (B,) of the batch at the network's input size.

    ``plane``: the centre lies where the ray through the projected 3D centre meets the plane z = height / 2.
    ``depth``: the centre lies on that ray at the regressed depth.
    ``fused``: on that ray between the two, each weighted by its regressed precision, and half its height above ground.
    ``ground``: over the place where the ray through the footprint's projected centre meets the ground, z = 0.
    ``fitted``: as ``ground``, where the fit to all that the heads say begins (`wibam_core.networks.small.reconcile`).
    ``refined``: as ``fitted``, to edges of a second look at each vehicle (`wibam_core.models.second_look`).
    """
    seen_by = cameras[values.image]
    sizes = sizes_m(values, mean_sizes_m)
    aimed, plane_m = _aimed(values, sizes[:, 2] / 2, decode)
    position = _positions(seen_by, aimed, plane_m, _plane_share(seen_by, aimed, plane_m, decode))
    if decode != "depth":
        position = torch.cat([position[:, :2], sizes[:, 2:] / 2], dim=-1)
    azimuth = azimuths_rad(rays(seen_by, centres3d_px(values)))
    yaw = azimuth + torch.atan2(values.yaw[:, 0], values.yaw[:, 1])
    return torch.cat([position, sizes, wrap_angle(yaw)[:, None]], dim=-1)


def _aimed(values: PeakValues, centre_m: Tensor, decode: Decode) -> tuple[PeakValues, Tensor]:
    """What is placed, in the 3D centre's stead where that is the footprint, and how high (N,) it lies.

    ``centre_m`` (N,) is how high the 3D centres lie.
    """
    if decode not in _BY_FOOTPRINT:
        return values, centre_m
    log_scale = torch.cat([values.log_scale[:, [_FOOTPRINT]], values.log_scale[:, 1:]], dim=-1)
    return replace(values, centre3d=values.footprint, log_scale=log_scale), torch.zeros_like(centre_m)


def _positions(seen_by: CameraTensors, values: PeakValues, plane_m: Tensor, plane_share: Tensor | None) -> Tensor:
    """(N, 3) where the rays through the projected 3D centres reach.

    ``plane_share`` (N,) is how far the planes z = ``plane_m`` (N,) decide the reach along the ray, against the depth;
    without one the depth alone decides.
    """
    directions = rays(seen_by, centres3d_px(values))
    depth = values.depth.clamp(-2.0, 7.0).exp() * focal_px(seen_by) / REFERENCE_FOCAL_PX
    reach = depth / (directions * seen_by.rotation[:, 2]).sum(dim=-1)
    if plane_share is None:
        return seen_by.centre_m + directions * reach[:, None]
    reach = torch.lerp(reach, _reach_of_plane(seen_by, directions, plane_m), plane_share)
    return torch.cat([seen_by.centre_m[:, :2] + directions[:, :2] * reach[:, None], plane_m[:, None]], dim=-1)


def _plane_share(seen_by: CameraTensors, values: PeakValues, plane_m: Tensor, decode: Decode) -> Tensor | None:
    """(N,) see `_positions`; without gradient, since only errors may teach the uncertainties."""
    if decode == "depth":
        return None
    if decode != "fused":
        return torch.ones_like(plane_m)
    with torch.no_grad():
        deviation = deviations(values)
        directions, higher, lower = _rays_within(seen_by, values, deviation)
        reach = _reach_of_plane(seen_by, directions, plane_m)
        of_pixel = (_reach_of_plane(seen_by, higher, plane_m) - _reach_of_plane(seen_by, lower, plane_m)) / 2
        of_height = _reach_of_plane(seen_by, directions, plane_m * (1 + deviation[:, 2])) - reach
        of_plane = of_pixel.square() + of_height.square()
        of_depth = (reach * deviation[:, 1]).square()
        share = of_depth / (of_plane + of_depth)
        return torch.where(_grazes(higher), torch.zeros_like(share), share)


def _rays_within(seen_by: CameraTensors, values: PeakValues, deviation: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Rays (N, 3) through the projected 3D centres, and those one standard deviation above and below in the image."""
    pixels = centres3d_px(values)
    down = torch.zeros_like(pixels)
    down[:, 1] = deviation[:, 0] * STRIDE
    return rays(seen_by, pixels), rays(seen_by, pixels - down), rays(seen_by, pixels + down)


def centres3d_px(values: PeakValues) -> Tensor:
    """Projected 3D centres (N, 2), input px."""
    return cell_centres_px(values.cells + values.centre3d)


def footprints_px(values: PeakValues) -> Tensor:
    """Projected centres of the footprints (N, 2), input px."""
    return cell_centres_px(values.cells + values.footprint)


def _reach_of_plane(cameras: CameraTensors, directions: Tensor, height_m: Tensor) -> Tensor:
    """(N,) how many times their length rays (N, 3) reach until they meet the planes z = height_m (N,)."""
    descent = torch.minimum(directions[:, 2], _least_descent(directions))
    return (height_m - cameras.centre_m[:, 2]) / descent


def _least_descent(directions: Tensor) -> Tensor:
    return -_MIN_DESCENT * torch.linalg.norm(directions[:, :2], dim=-1)


def _grazes(directions: Tensor) -> Tensor:
    """(N,) whether rays (N, 3) are so close to the horizon that they tell nothing of where they meet a plane."""
    return directions[:, 2] > _least_descent(directions)


def deviations(values: PeakValues) -> Tensor:
    """(N, 5) standard deviations of `UNCERTAINTY_GROUPS`: a regressed scale is that of a Laplace distribution."""
    return values.log_scale.clamp(-6.0, 3.0).exp() * 2**0.5


def standard_deviations(values: PeakValues, boxes: Tensor, cameras: CameraTensors, decode: Decode) -> Tensor:
    """(N, 7) standard deviations of boxes (N, 7) in m and rad, from the regressed scales.

    The centre's follows from one standard deviation of the projected 3D centre, or footprint, moved along the ray as
    the decoding moves it, and, unless the plane alone decides, one of the depth. Where the plane alone decides and may
    lie beyond the horizon, it is the whole distance.
    """
    seen_by = cameras[values.image]
    values, plane_m = _aimed(values, boxes[:, HEIGHT] / 2, decode)
    scale = deviations(values)
    size_sd = boxes[:, SIZE] * scale[:, 2:3]
    plane_share = _plane_share(seen_by, values, plane_m, decode)

    def spread(name: str, step: Tensor) -> Tensor:
        value: Tensor = getattr(values, name)
        low, high = (
            _positions(seen_by, replace(values, **{name: value + sign * step / 2}), plane_m, plane_share)
            for sign in (-1.0, 1.0)
        )
        return (high - low).square()

    steps = scale[:, :1] * torch.eye(2, dtype=scale.dtype)[:, None]
    variance = spread("centre3d", steps[0]) + spread("centre3d", steps[1])
    if decode in ("depth", "fused"):
        variance = variance + spread("depth", scale[:, 1])
    else:
        _, higher, _ = _rays_within(seen_by, values, scale)
        away = (boxes[:, XYZ] - seen_by.centre_m).square()
        variance = variance + torch.where(_grazes(higher)[:, None], away, torch.zeros_like(away))
    z_sd = variance[:, 2:].sqrt() if decode == "depth" else size_sd[:, 2:] / 2
    return torch.cat([variance[:, :2].sqrt(), z_sd, size_sd, scale[:, 3:4].clamp(max=torch.pi)], dim=-1)
