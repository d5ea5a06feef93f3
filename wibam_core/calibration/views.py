"""Which pinhole views are cut from the picture of a wide lens: as the user says, or such that they show the road.

Left to itself, a view is `_ACROSS_DEG` wide, and as many stand side by side, overlapping by at least `_OVERLAP_DEG`, as
the road takes in view. A lens that looks down sees road all around; then the half towards the site's other cameras is
what matters, and all around only where there is no other.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from wibam_core.calibration.view import visible_ground
from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.cut_view import CutView
from wibam_core.site import Site, ViewDirection

Array = NDArray[np.float64]

_ACROSS_DEG = 90.0
_OVERLAP_DEG = 20.0
#: A view that is alone is as wide as the road in it, within these.
_ALONE_DEG = (50.0, 100.0)
#: Views show the road up to this far, and what is as high as this on it.
_RANGE_M, _HIGHEST_M = 80.0, 4.5
#: Their upper and lower border lie within these angles below the horizon, and this far apart.
_BELOW_HORIZON_DEG, _HEIGHT_DEG = (-2.0, 75.0), (40.0, 78.0)
#: Steeper than this, an optical axis tells no direction over the ground.
_STEEP_DEG = 55.0
#: Cameras nearer to each other than this (m) tell none, either.
_APART_M = 3.0
#: How much finer the middle of a view is than the picture there, so that little is lost by cutting.
_FINER = 1.25
_SIZE_PX = (64, 4096)


def views_of_site(site: Site, mounted: Mapping[str, Camera]) -> dict[str, tuple[CutView, ...]]:
    """The views of every camera with a wide lens, by camera id.

    Args:
        site: what the user says of views.
        mounted: camera id -> calibrated camera.

    Raises:
        CalibrationError: a view shows nothing of the picture, or too much for a picture.
    """
    found: dict[str, tuple[CutView, ...]] = {}
    for described in site.cameras:
        camera = mounted[described.id]
        if not camera.is_wide:
            continue
        others = [other.centre_m[:2] for id_, other in mounted.items() if id_ != described.id]
        directions = described.views or suggested_views(camera, np.array(others).reshape(-1, 2))
        try:
            found[described.id] = tuple(
                cut_view(camera, direction, f"{described.id}.{number}")
                for number, direction in enumerate(directions, 1)
            )
        except CalibrationError as error:
            details = {"camera": described.id, **error.details}
            message = f"camera {described.id}: {error.message}"
            raise CalibrationError(message, hint=error.hint, **details) from error
    return found


def suggested_views(camera: Camera, others: Array) -> tuple[ViewDirection, ...]:
    """Views that show the road.

    Args:
        camera: with a wide lens, which sees road.
        others: (M, 2) where the other cameras of its site stand, x and y in m.
    """
    ground = visible_ground(camera, steps=96) - camera.centre_m
    ground = ground[np.linalg.norm(ground[:, :2], axis=1) <= _RANGE_M]
    forward = camera.T_world_cam.rotation[:, 2]
    towards = forward[:2]
    if np.degrees(np.arcsin(-forward[2])) > _STEEP_DEG:
        towards = others.mean(axis=0) - camera.centre_m[:2] if len(others) else np.zeros(2)
        if np.linalg.norm(towards) < _APART_M:
            return _all_around(ground, camera)
    middle_deg = float(np.degrees(np.arctan2(towards[1], towards[0])))
    aside_deg = (np.degrees(np.arctan2(ground[:, 1], ground[:, 0])) - middle_deg + 180) % 360 - 180
    facing = np.abs(aside_deg) <= 90
    if not facing.any():
        return _all_around(ground, camera)
    left, right = float(aside_deg[facing].max()), float(aside_deg[facing].min())
    width_deg = left - right
    count = max(int(np.ceil((width_deg - _OVERLAP_DEG) / (_ACROSS_DEG - _OVERLAP_DEG) - 1e-9)), 1)
    if count == 1:
        across_deg = float(np.clip(width_deg, *_ALONE_DEG))
        aside = [(left + right) / 2]
    else:
        across_deg = _ACROSS_DEG
        aside = np.linspace(left - across_deg / 2, right + across_deg / 2, count).tolist()
    return tuple(_direction(middle_deg + turn, across_deg, ground[facing], camera) for turn in aside)


def _all_around(ground: Array, camera: Camera) -> tuple[ViewDirection, ...]:
    count = int(np.ceil(360 / (_ACROSS_DEG - _OVERLAP_DEG)))
    return tuple(_direction(360 / count * k, _ACROSS_DEG, ground, camera) for k in range(count))


def _direction(azimuth_deg: float, across_deg: float, ground: Array, camera: Camera) -> ViewDirection:
    """A view that shows road points (N, 3), counted from the camera, and what stands on them, to whole degrees."""
    aside = (np.degrees(np.arctan2(ground[:, 1], ground[:, 0])) - azimuth_deg + 180) % 360 - 180
    here = ground[np.abs(aside) <= across_deg / 2]
    points = here if len(here) else ground
    away = np.linalg.norm(points[:, :2], axis=1)
    height_m = float(camera.centre_m[2])
    below = np.degrees(np.arctan2(height_m, away))
    highest = np.degrees(np.arctan2(height_m - _HIGHEST_M, away.max()))
    top, bottom = np.clip([min(highest, below.min()), below.max()], *_BELOW_HORIZON_DEG)
    height_deg = float(np.clip(bottom - top, *_HEIGHT_DEG))
    return ViewDirection(
        azimuth_deg=float(np.round((azimuth_deg + 180) % 360 - 180)),
        down_deg=float(np.round(top + height_deg / 2)),
        across_deg=float(np.round(across_deg)),
        height_deg=float(np.round(height_deg)),
    )


def cut_view(camera: Camera, direction: ViewDirection, view_id: str) -> CutView:
    """The view of a camera in a direction over the ground, upright, about as fine as the camera's picture.

    Raises:
        CalibrationError: the lens does not see that way.
    """
    a, d = np.radians(direction.azimuth_deg), np.radians(direction.down_deg)
    forward = np.array([np.cos(a) * np.cos(d), np.sin(a) * np.cos(d), -np.sin(d)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    R_world_view = np.stack([right, np.cross(forward, right), forward], axis=1)
    R_cam_view = camera.T_world_cam.rotation.T @ R_world_view
    shown, px_per_rad = _resolution(camera, R_cam_view)
    if not shown:
        raise CalibrationError(
            f"the view {view_id} looks {direction.down_deg:g}° down at azimuth {direction.azimuth_deg:g}°, where the "
            "picture shows nothing",
            hint="azimuth_deg counts counter-clockwise from the world's X axis: correct it, or leave views out.",
        )
    focal = _FINER * px_per_rad
    half = np.tan(np.radians([direction.across_deg, direction.height_deg]) / 2)
    width, height = (int(2 * round(focal * side)) for side in half)
    if not (_SIZE_PX[0] <= min(width, height) and max(width, height) <= _SIZE_PX[1]):
        raise CalibrationError(
            f"the view {view_id} would be {width}x{height} px",
            hint=f"Change across_deg and height_deg: from {_SIZE_PX[0]} to {_SIZE_PX[1]} px are cut.",
        )
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    return CutView(view_id, R_cam_view, K, width, height)


def _resolution(camera: Camera, R_cam_view: Array) -> tuple[bool, float]:
    """Whether the picture shows the middle of a view, and how many of its pixels make a radian there."""
    step_rad = 1e-4
    middle = R_cam_view[:, 2]
    near = np.stack([middle, middle + step_rad * R_cam_view[:, 0], middle + step_rad * R_cam_view[:, 1]])
    pixels = camera.project_camera_points(near)
    if not camera.contains(pixels[0]):
        return False, 0.0
    by_angle = np.stack([pixels[1] - pixels[0], pixels[2] - pixels[0]], axis=1) / step_rad
    return True, float(np.sqrt(abs(np.linalg.det(by_angle))))
