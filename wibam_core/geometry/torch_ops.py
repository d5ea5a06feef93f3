"""Differentiable twins of the NumPy geometry, batched over cameras. Same names, frames and units.

Leading dimensions broadcast: a `CameraTensors` of shape (V,) projects points (V, ..., 3); index it with any
integer tensor to line cameras up with other data, e.g. ``cameras[view_of_vehicle]``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from wibam_core.geometry import distortion
from wibam_core.geometry.box3d import EDGES, SIZE, UNIT_CORNERS, YAW, X, Y, Z
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import EDGE_SHARES, NEAR_M


@dataclass(frozen=True, eq=False)
class CameraTensors:
    """Cameras as tensors.

    Attributes:
        K: (V, 3, 3), px. dist: (V, 12) coefficients in OpenCV order, zero where unused.
        rotation: (V, 3, 3) and translation: (V, 3) of ``T_cam_world``.
        size: (V, 2) width and height, px. limit: (V,) undistorted radius beyond which distortion goes on in straight
            lines, see `wibam_core.geometry.distortion`.
    """

    K: Tensor
    dist: Tensor
    rotation: Tensor
    translation: Tensor
    size: Tensor
    limit: Tensor

    @classmethod
    def from_cameras(
        cls, cameras: Sequence[Camera], dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu"
    ) -> CameraTensors:
        """Stack cameras with pinholes.

        Raises:
            ValueError: one has a wide lens; networks see its views.
        """
        if any(camera.is_wide for camera in cameras):
            raise ValueError("a wide lens is no pinhole: give the views that are cut from its picture")

        def stack(values: list[list[float]]) -> Tensor:
            return torch.tensor(values, dtype=torch.float64).to(device=device, dtype=dtype)

        poses = [camera.T_cam_world for camera in cameras]
        return cls(
            K=stack([c.K.tolist() for c in cameras]),
            dist=stack([(c.dist.tolist() + [0.0] * 12)[:12] for c in cameras]),
            rotation=stack([T.rotation.tolist() for T in poses]),
            translation=stack([T.translation.tolist() for T in poses]),
            size=stack([[c.width_px, c.height_px] for c in cameras]),
            limit=stack([[min(c.distortion_limit, 1e9)] for c in cameras])[:, 0],
        )

    def __getitem__(self, index: Tensor | slice | int) -> CameraTensors:
        return CameraTensors(
            self.K[index],
            self.dist[index],
            self.rotation[index],
            self.translation[index],
            self.size[index],
            self.limit[index],
        )

    def to(self, device: torch.device) -> CameraTensors:
        """The same on another device."""
        return CameraTensors(**{name: value.to(device) for name, value in vars(self).items()})

    @property
    def centre_m(self) -> Tensor:
        """(V, 3) optical centres in the world."""
        return -(self.rotation.transpose(-1, -2) @ self.translation[..., None])[..., 0]


def _like(values: Tensor, points: Tensor, trailing: int) -> Tensor:
    """Insert dimensions so that per-camera ``values`` (V, [trailing dims]) broadcast with ``points`` (V, ..., k)."""
    lead = values.dim() - trailing
    extra = points.dim() - 1 - lead
    return values.reshape(*values.shape[:lead], *([1] * extra), *values.shape[lead:])


def vehicle_to_world(boxes: Tensor, points_vehicle: Tensor) -> Tensor:
    """Points (..., K, 3) in the vehicle frames of boxes (..., 7), in the world (..., K, 3)."""
    c, s = boxes[..., YAW, None].cos(), boxes[..., YAW, None].sin()
    x = c * points_vehicle[..., 0] - s * points_vehicle[..., 1] + boxes[..., X, None]
    y = s * points_vehicle[..., 0] + c * points_vehicle[..., 1] + boxes[..., Y, None]
    z = points_vehicle[..., 2] + boxes[..., Z, None]
    return torch.stack([x, y, z], dim=-1)


def corners(boxes: Tensor) -> Tensor:
    """World corners (..., 8, 3) of boxes (..., 7), numbered as in `wibam_core.geometry.box3d`."""
    unit = torch.as_tensor(UNIT_CORNERS.copy(), dtype=boxes.dtype, device=boxes.device)
    return vehicle_to_world(boxes, unit * boxes[..., None, SIZE])


def to_camera(cameras: CameraTensors, points_world: Tensor) -> Tensor:
    """World points (V, ..., 3) in the camera frames (V, ..., 3)."""
    rotation = _like(cameras.rotation, points_world, 2)
    return (rotation @ points_world[..., None])[..., 0] + _like(cameras.translation, points_world, 1)


def _clamped(cameras: CameraTensors, xy: Tensor) -> tuple[Tensor, Tensor]:
    """Points (V, ..., 2) pulled in to the cameras' limits, and by which factors (V, ..., 1)."""
    limit = _like(cameras.limit[..., None], xy, 1)
    inside = limit / torch.maximum(xy.norm(dim=-1, keepdim=True), limit)
    return xy * inside, inside


def _polynomial(cameras: CameraTensors, xy: Tensor) -> Tensor:
    coefficients = _like(cameras.dist, xy, 1).unbind(-1)
    return torch.stack(distortion.polynomial(coefficients, *xy.unbind(-1)), dim=-1)


def _distort(cameras: CameraTensors, xy: Tensor) -> Tensor:
    """Twin of `wibam_core.geometry.distortion.distort`: (V, ..., 2) to (V, ..., 2)."""
    clamped, inside = _clamped(cameras, xy)
    return _polynomial(cameras, clamped) / inside


def project_camera_points(cameras: CameraTensors, points_cam: Tensor) -> Tensor:
    """Camera-frame points (V, ..., 3) with positive z to pixels (V, ..., 2)."""
    xy = points_cam[..., :2] / points_cam[..., 2:3]
    if bool((cameras.dist != 0).any()):
        xy = _distort(cameras, xy)
    K = _like(cameras.K, xy, 2)
    u = K[..., 0, 0] * xy[..., 0] + K[..., 0, 1] * xy[..., 1] + K[..., 0, 2]
    v = K[..., 1, 1] * xy[..., 1] + K[..., 1, 2]
    return torch.stack([u, v], dim=-1)


def project(cameras: CameraTensors, points_world: Tensor) -> tuple[Tensor, Tensor]:
    """Project world points (V, ..., 3): pixels (V, ..., 2) and depths (V, ...) in m.

    Pixels of points at depth <= 0 are those of the point pushed to 1 mm in front: check the depth.
    """
    cam = to_camera(cameras, points_world)
    depth = cam[..., 2]
    safe = torch.cat([cam[..., :2], depth.clamp_min(1e-3)[..., None]], dim=-1)
    return project_camera_points(cameras, safe), depth


def undistort(cameras: CameraTensors, uv: Tensor) -> Tensor:
    """Pixels (V, ..., 2) to normalised image coordinates (V, ..., 2).

    Where distorted, the derivatives are those of the last Newton step, hence of the inverse itself (implicit function
    theorem); there are no second ones.
    """
    K = _like(cameras.K, uv, 2)
    y = (uv[..., 1] - K[..., 1, 2]) / K[..., 1, 1]
    x = (uv[..., 0] - K[..., 0, 2] - K[..., 0, 1] * y) / K[..., 0, 0]
    target = torch.stack([x, y], dim=-1)
    if not bool((cameras.dist != 0).any()):
        return target
    with torch.no_grad():
        xy = _search(cameras, target)
    return xy + _newton_steps(cameras, xy, target - _distort(cameras, xy))


def _search(cameras: CameraTensors, target: Tensor) -> Tensor:
    """Twin of `wibam_core.geometry.distortion.undistort`, to within a few rounding errors: (V, ..., 2)."""
    xy = target
    missing = target - _distort(cameras, xy)
    error = missing.norm(dim=-1, keepdim=True)
    enough = distortion.ROUNDINGS * torch.finfo(xy.dtype).eps * target.norm(dim=-1, keepdim=True).clamp_min(1.0)
    step = _newton_steps(cameras, xy, missing)
    for _ in range(distortion.MAX_STEPS):
        if not bool((error > enough).any()):
            break
        trial = xy + step
        missing = target - _distort(cameras, trial)
        trial_error = missing.norm(dim=-1, keepdim=True)
        closer = trial_error < error
        xy, error = torch.where(closer, trial, xy), torch.where(closer, trial_error, error)
        step = torch.where(closer, _newton_steps(cameras, trial, missing), step / 2)
    return xy


def _newton_steps(cameras: CameraTensors, xy: Tensor, missing: Tensor) -> Tensor:
    """Moves (V, ..., 2) of points (V, ..., 2) that change what `_distort` gives by ``missing`` (V, ..., 2)."""
    coefficients = _like(cameras.dist, xy, 1).unbind(-1)
    clamped, inside = _clamped(cameras, xy)
    x, y = clamped.unbind(-1)
    a, b, c, d = distortion.polynomial_slopes(coefficients, x, y)
    # beyond the limit, moving outwards goes along the straight continuation instead
    limit = _like(cameras.limit[..., None], xy, 1)
    ux, uy = (clamped / limit).unbind(-1)
    sx, sy = (_polynomial(cameras, clamped) / limit).unbind(-1)
    beyond = (inside < 1)[..., 0].to(xy.dtype)
    kink_x, kink_y = beyond * (sx - a * ux - b * uy), beyond * (sy - c * ux - d * uy)
    a, b, c, d = a + kink_x * ux, b + kink_x * uy, c + kink_y * ux, d + kink_y * uy
    u, v = missing.unbind(-1)
    return torch.stack([d * u - b * v, a * v - c * u], dim=-1) / (a * d - b * c)[..., None]


def rays(cameras: CameraTensors, uv: Tensor) -> Tensor:
    """Unit directions in the world (V, ..., 3) through pixels (V, ..., 2)."""
    xy = undistort(cameras, uv)
    local = torch.cat([xy, torch.ones_like(xy[..., :1])], dim=-1)
    rotation = _like(cameras.rotation.transpose(-1, -2), local, 2)
    world = (rotation @ local[..., None])[..., 0]
    return world / world.norm(dim=-1, keepdim=True)


def intersect_plane(cameras: CameraTensors, uv: Tensor, height_m: Tensor, max_range_m: float = 500.0) -> Tensor:
    """World points (V, ..., 3) where rays through pixels (V, ..., 2) meet z = ``height_m`` (V, ...).

    Rays at or above the horizon give the point at ``max_range_m`` along them: finite, far, and recognisable.
    """
    direction = rays(cameras, uv)
    centre = _like(cameras.centre_m, direction, 1)
    drop = height_m - centre[..., 2]
    slope = direction[..., 2]
    meets = (drop * slope > 0) & (drop.abs() < max_range_m * slope.abs())
    distance = torch.where(meets, drop / torch.where(meets, slope, torch.ones_like(slope)), max_range_m)
    return centre + direction * distance[..., None]


def tight_boxes(
    cameras: CameraTensors, boxes: Tensor, near_m: float = NEAR_M, clamp: bool = True
) -> tuple[Tensor, Tensor]:
    """Tight xyxy boxes (V, ..., 4) in px around the projections of boxes (V, ..., 7), near-plane clipped.

    Twin of `wibam_core.geometry.projection.project_boxes`: where a camera has distortion, edges count along their
    length.

    Returns:
        the boxes, and a mask (V, ...) of those with anything in front of the camera and, with ``clamp``, in the image.
    """
    cam = to_camera(cameras, corners(boxes))
    edges = torch.as_tensor(EDGES.copy(), device=boxes.device)
    start, end = cam[..., edges[:, 0], :], cam[..., edges[:, 1], :]
    z0, z1 = start[..., 2:3], end[..., 2:3]
    span = z1 - z0
    one_side = (z0 < near_m) != (z1 < near_m)
    t = torch.where(
        one_side, (near_m - z0) / torch.where(one_side, span, torch.ones_like(span)), torch.zeros_like(span)
    )
    cut = start + t * (end - start)
    seen = (torch.maximum(z0, z1) >= near_m)[..., 0]
    start = torch.where(z0 < near_m, cut, start)
    end = torch.where(z1 < near_m, cut, end)
    if bool((cameras.dist != 0).any()):
        along = end - start
        parts = [start + share * along for share in EDGE_SHARES[:-1].tolist()] + [end]
    else:
        parts = [start, end]
    points = torch.cat(parts, dim=-2)
    seen = torch.cat([seen] * len(parts), dim=-1)
    in_front = torch.tensor([0.0, 0.0, 1.0], dtype=points.dtype, device=points.device)
    uv = project_camera_points(cameras, torch.where(seen[..., None], points, in_front))
    infinity = torch.full_like(uv, torch.inf)
    low = torch.where(seen[..., None], uv, infinity).amin(dim=-2)
    high = torch.where(seen[..., None], uv, -infinity).amax(dim=-2)
    valid = seen.any(dim=-1)
    zero = torch.zeros_like(low)
    low, high = torch.where(valid[..., None], low, zero), torch.where(valid[..., None], high, zero)
    if clamp:
        limits = _like(cameras.size, low, 1) - 0.5
        valid = valid & (low < limits).all(dim=-1) & (high > -0.5).all(dim=-1)
        low = torch.minimum(low.clamp_min(-0.5), limits)
        high = torch.minimum(high.clamp_min(-0.5), limits)
    return torch.cat([low, high], dim=-1), valid


def giou(a: Tensor, b: Tensor) -> Tensor:
    """Generalised IoU (...) in [−1, 1] of xyxy boxes a (..., 4) and b (..., 4), pair by pair (Rezatofighi 2019)."""
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    overlap = (high - low).clamp_min(0).prod(dim=-1)
    area_a = (a[..., 2:] - a[..., :2]).clamp_min(0).prod(dim=-1)
    area_b = (b[..., 2:] - b[..., :2]).clamp_min(0).prod(dim=-1)
    union = (area_a + area_b - overlap).clamp_min(1e-9)
    hull = (torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])).prod(dim=-1).clamp_min(1e-9)
    return overlap / union - (hull - union) / hull


def focal_px(cameras: CameraTensors) -> Tensor:
    """(N,) geometric means of the focal lengths."""
    return torch.sqrt(cameras.K[:, 0, 0] * cameras.K[:, 1, 1])


def azimuths_rad(rays: Tensor) -> Tensor:
    """(N,) azimuth about world +Z of directions (N, 3)."""
    return torch.atan2(rays[:, 1], rays[:, 0])


def wrap_angle(angle_rad: Tensor) -> Tensor:
    """Angles (...) wrapped to (−π, π]."""
    return angle_rad - 2 * torch.pi * torch.ceil((angle_rad - torch.pi) / (2 * torch.pi)).detach()
