"""Rendered views that vary all that a detector should not depend on: materials, bodies, clutter, light, distances.

For training alone: simulated sites (`wibam simulate`) and `sample_views` look as they always did.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import XY, XYZ
from wibam_core.geometry.camera import Camera
from wibam_core.road_users import RoadUserClass
from wibam_core.synthetic.cameras import elevated_camera, intrinsics, look_at
from wibam_core.synthetic.clutter import cluttered
from wibam_core.synthetic.layout import Layout, make_layout
from wibam_core.synthetic.lighting import Lighting, sample_lighting
from wibam_core.synthetic.routes import make_routes
from wibam_core.synthetic.sampling import VIEWS_PER_MOMENT, RenderedView, rendered, sample_moment
from wibam_core.synthetic.textured_background import sample_materials
from wibam_core.synthetic.textured_render import TexturedRenderer
from wibam_core.synthetic.varied_vehicles import sample_varied
from wibam_core.synthetic.vehicles import VehicleModel, sample_vehicle

Array = NDArray[np.float64]

_HEIGHT_M = (2.0, 14.0)
#: Share of vehicles that look as in simulated traffic.
_USUAL_BODIES = 0.15
#: Share of views that are aimed at one vehicle, and how large a car there is, in image widths, mostly and when near.
_AIMED, _LARGE, _NEAR = 0.7, (0.035, 0.6), (0.2, 0.7)
_FOCAL = (0.5, 2.0)
_AWAY_M = (5.0, 90.0)
_MOMENTS = 2
#: Nobody hangs a camera into a vehicle.
_CLEAR_M = 6.0
_TRIES = 40


def sample_varied_views(
    seed: int, count: int, size_px: tuple[int, int] = (640, 360), near: float = 0.0
) -> Iterator[RenderedView]:
    """Varied views, 2–14 m high, of the intersection number ``seed``; the same arguments give the same views.

    Every `VIEWS_PER_MOMENT` views the light and all materials change. Each camera is used for `_MOMENTS` views in a
    row, of other traffic: what stands still is painted once, and a detector sees it with and without vehicles. Of the
    cameras that are aimed at a vehicle, the share ``near`` sees it large.
    """
    plain = make_layout(seed)
    routes = make_routes(plain)
    for first in range(0, count, VIEWS_PER_MOMENT):
        rng = np.random.default_rng([seed, 29, first])
        layout = cluttered(plain, rng)
        moments = [sample_moment(layout, routes, rng, _sample_any) for _ in range(_MOMENTS)]
        lighting = _varied_lighting(rng)
        materials = sample_materials(layout, rng)
        for number in range(min(VIEWS_PER_MOMENT, count - first)):
            models, boxes = moments[number % _MOMENTS]
            if number % _MOMENTS == 0:
                camera = _camera(layout, boxes, rng, size_px, near)
                renderer = TexturedRenderer(layout, lighting, camera, materials)
            yield rendered(renderer, models, boxes, np.arange(len(boxes)), rng)


def _sample_any(rng: np.random.Generator, mix: dict[RoadUserClass, float]) -> VehicleModel:
    return sample_vehicle(rng, mix) if rng.random() < _USUAL_BODIES else sample_varied(rng, mix)


def _varied_lighting(rng: np.random.Generator) -> Lighting:
    """From deep night-like shade to glaring sun, low or high."""
    usual = sample_lighting(rng)
    elevation, azimuth = np.deg2rad(rng.uniform(10, 75)), rng.uniform(-np.pi, np.pi)
    flat = np.cos(elevation)
    strength = rng.uniform(0.75, 1.15)
    return replace(
        usual,
        sun=(float(flat * np.cos(azimuth)), float(flat * np.sin(azimuth)), float(np.sin(elevation))),
        ambient=usual.ambient * float(strength * rng.uniform(0.75, 1.15)),
        diffuse=usual.diffuse * float(strength * rng.uniform(0.5, 1.4)),
        shadow=float(np.clip(usual.shadow * rng.uniform(0.6, 1.1), 0.25, 0.98)),
        haze_m=float(np.exp(rng.uniform(np.log(60), np.log(900)))),
    )


def _camera(layout: Layout, boxes: Array, rng: np.random.Generator, size_px: tuple[int, int], near: float) -> Camera:
    """A camera that looks at the middle, or at one vehicle from anywhere, with nothing large between."""
    aimed = len(boxes) > 0 and rng.random() < _AIMED
    for _ in range(_TRIES):
        if not aimed:
            camera = elevated_camera(layout, rng, size_px)
            if _in_sight(layout, camera.centre_m, np.zeros(3)):
                break
            continue
        target = boxes[int(rng.integers(len(boxes))), XYZ]
        focal = float(np.exp(rng.uniform(*np.log(_FOCAL))))
        size = float(rng.uniform(*_NEAR) if near and rng.random() < near else np.exp(rng.uniform(*np.log(_LARGE))))
        away = float(np.clip(focal * 4.5 / size, *_AWAY_M))
        angle, height = rng.uniform(-np.pi, np.pi), rng.uniform(*_HEIGHT_M)
        flat = np.sqrt(max(away**2 - height**2, (0.5 * away) ** 2))
        place = np.array([*(target[:2] + flat * np.array([np.cos(angle), np.sin(angle)])), height])
        clear = np.hypot(*(boxes[:, XY] - place[:2]).T).min() > _CLEAR_M or height > 5.0
        aim = target + rng.normal(0, 0.16 * away / focal, 3) * [1, 1, 0.4]
        pose = look_at(place, aim, rng.normal(0, 0.035))
        camera = Camera(intrinsics(focal, size_px), np.zeros(0), pose, *size_px)
        if clear and layout.is_free(float(place[0]), float(place[1]), 3.0) and _in_sight(layout, place, target):
            break
    return camera


def _in_sight(layout: Layout, eye: Array, target: Array) -> bool:
    """Whether no building stands between two places (3,)."""
    line = eye + np.linspace(0, 1, 24)[:, None] * (target - eye)
    for building in layout.buildings:
        outline = building.footprint.astype(np.float32)
        low, high = outline.min(axis=0), outline.max(axis=0)
        near = line[((line[:, :2] >= low) & (line[:, :2] <= high)).all(axis=1) & (line[:, 2] < building.height_m)]
        if any(cv2.pointPolygonTest(outline, (float(x), float(y)), False) >= 0 for x, y, _ in near):
            return False
    return True
