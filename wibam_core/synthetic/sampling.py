"""Random rendered views with truth, for training networks and for tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import YAW
from wibam_core.geometry.camera import Camera
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Vehicles3D
from wibam_core.synthetic.cameras import ego_camera, elevated_camera, site_cameras
from wibam_core.synthetic.layout import PARKING_M, PHASES, Layout, make_layout
from wibam_core.synthetic.lighting import develop, sample_lighting, sample_photometry
from wibam_core.synthetic.raster import Image
from wibam_core.synthetic.render import Renderer
from wibam_core.synthetic.routes import Route, footprints_overlap, make_routes
from wibam_core.synthetic.vehicles import VehicleModel, sample_vehicle

Array = NDArray[np.float64]
Regime = Literal["ego", "site", "elevated"]

#: Views that share one moment (traffic and light) of an intersection.
VIEWS_PER_MOMENT = 10
#: Large vehicles are more frequent than in ordinary traffic, so that networks see enough of them.
TRAINING_MIX = {RoadUserClass.CAR: 0.64, RoadUserClass.VAN: 0.15, RoadUserClass.TRUCK: 0.12, RoadUserClass.BUS: 0.09}
#: Half of the length and width of the vehicle that carries an ego camera: nothing else stands there.
_EGO_HALF_M = (3.0, 1.3)


@dataclass(frozen=True, eq=False)
class RenderedView:
    """One image with exact truth, one row per vehicle whose silhouette reaches into the image.

    Vehicles that are small or hidden are listed too; `visibility` tells.

    Attributes:
        image: (H, W, 3) uint8 BGR.
        camera: the camera of this very image size.
        vehicles: N true boxes in the world (z of the centre is half the height), time 0.
        visible_boxes: (N, 4) xyxy px around the visible pixels; zeros where none is visible.
        amodal_boxes: (N, 4) xyxy px around the whole silhouette, clipped to the image.
        visibility: (N,) visible share of the whole silhouette, parts beyond the image's border included.
        still: (H, W, 3) uint8 BGR: what the camera would show without vehicles.
    """

    image: Image
    camera: Camera
    vehicles: Vehicles3D
    visible_boxes: Array
    amodal_boxes: Array
    visibility: Array
    still: Image


def sample_views(
    seed: int, regime: Regime, count: int, size_px: tuple[int, int] = (512, 288)
) -> Iterator[RenderedView]:
    """Rendered views of the intersection number ``seed``; the same arguments give the same views.

    Every `VIEWS_PER_MOMENT` views the traffic, the light and the camera settings change.

    Args:
        seed: gives layout, traffic, light and cameras.
        regime: "ego" (street level, 1.2–3 m), "site" (corner poles, 5–10 m) or "elevated" (2–14 m, anywhere).
        count: how many views.
        size_px: width and height.
    """
    regimes: tuple[Regime, ...] = ("ego", "site", "elevated")
    layout = make_layout(seed)
    routes = make_routes(layout)
    for first in range(0, count, VIEWS_PER_MOMENT):
        rng = np.random.default_rng([seed, 23, regimes.index(regime), first])
        models, boxes = sample_moment(layout, routes, rng)
        lighting = sample_lighting(rng)
        number = min(VIEWS_PER_MOMENT, count - first)
        for camera in _cameras(layout, rng, regime, number, size_px):
            keep = np.ones(len(boxes), bool)
            if regime == "ego":
                keep = ~_at_ego(camera, boxes)
            renderer = Renderer(layout, lighting, camera)
            yield rendered(renderer, models, boxes, np.flatnonzero(keep), rng)


def rendered(
    renderer: Renderer,
    models: Sequence[VehicleModel],
    boxes: Array,
    chosen: NDArray[np.int64],
    rng: np.random.Generator,
) -> RenderedView:
    """What a camera shows of the vehicles with the given numbers, which are their ids."""
    signals = _signals(rng)
    drawing = renderer.draw([models[i] for i in chosen], boxes[chosen], signals)
    photometry = sample_photometry(rng)
    seen = drawing.in_view
    chosen = chosen[seen]
    return RenderedView(
        image=develop(drawing.image, photometry, rng),
        camera=renderer.view.camera,
        vehicles=Vehicles3D.of(
            0,
            boxes[chosen],
            classes=np.array([models[i].vehicle_class.number for i in chosen], dtype=np.int64),
            ids=chosen.astype(np.int64),
        ),
        visible_boxes=drawing.visible_boxes[seen],
        amodal_boxes=drawing.amodal_boxes[seen],
        visibility=drawing.visibility[seen],
        still=develop(renderer.background.images(signals)[0], replace(photometry, noise_sd=0.0), rng),
    )


#: Draws a vehicle by the shares of classes.
Choose = Callable[[np.random.Generator, dict[RoadUserClass, float]], VehicleModel]


def sample_moment(
    layout: Layout, routes: Sequence[Route], rng: np.random.Generator, choose: Choose = sample_vehicle
) -> tuple[list[VehicleModel], Array]:
    """Vehicles that drive, queue, turn and park at one moment: looks, and boxes (N, 7) that do not overlap."""
    models: list[VehicleModel] = []
    boxes = np.zeros((0, 7))

    def place(model: VehicleModel, x: float, y: float, yaw: float) -> None:
        nonlocal boxes
        length, width, height = model.size_m
        box = np.array([x, y, height / 2, length, width, height, yaw])
        padded = box + np.array([0, 0, 0, 0.9, 0.25, 0, 0])
        if not len(boxes) or not footprints_overlap(padded, boxes).any():
            models.append(model)
            boxes = np.concatenate([boxes, box[None]])

    busy = rng.integers(6, 24)
    for _ in range(int(busy)):
        route = routes[int(rng.integers(len(routes)))]
        draw = rng.random()
        if draw < 0.35:
            s = rng.uniform(*route.box_s_m)
        elif draw < 0.65:
            s = route.stop_s_m - rng.exponential(14.0)
        else:
            s = rng.uniform(10.0, route.length_m - 10.0)
        model = choose(rng, TRAINING_MIX)
        x, y, yaw = route.poses(s, model.length_m)
        jitter = rng.normal(0, 0.25, 2)
        place(model, x + jitter[0], y + jitter[1], yaw + rng.normal(0, 0.03))
    for arm in layout.arms:
        if not arm.parking:
            continue
        for side in (1, -1):
            edge = arm.in_edge_m if side > 0 else -arm.out_edge_m
            along = arm.parking_start_m + rng.uniform(2, 12)
            while along < arm.parking_start_m + 45:
                model = choose(rng, {RoadUserClass.CAR: 0.85, RoadUserClass.VAN: 0.15})
                x, y = arm.point(along + model.length_m / 2, side * (edge + PARKING_M / 2))
                backwards = rng.random() < 0.15
                yaw = arm.heading_rad + (np.pi if (side > 0) != backwards else 0.0) + rng.normal(0, 0.02)
                if rng.random() < 0.55:
                    place(model, x, y, yaw)
                along += model.length_m + rng.uniform(0.8, 3.0)
    boxes[:, YAW] = np.arctan2(np.sin(boxes[:, YAW]), np.cos(boxes[:, YAW]))
    return models, boxes


def _cameras(
    layout: Layout, rng: np.random.Generator, regime: Regime, count: int, size_px: tuple[int, int]
) -> Iterator[Camera]:
    if regime == "site":
        cameras: list[Camera] = []
        while len(cameras) < count:
            cameras += site_cameras(layout, rng, 4, size_px)
        yield from cameras[:count]
        return
    choose = ego_camera if regime == "ego" else elevated_camera
    for _ in range(count):
        yield choose(layout, rng, size_px)


def _at_ego(camera: Camera, boxes: Array) -> NDArray[np.bool_]:
    """Which vehicles overlap the one that carries the camera."""
    x, y, z = camera.centre_m
    forward = camera.T_world_cam.rotation[:, 2]
    half_length, half_width = _EGO_HALF_M
    ego = np.array([x, y, z, 2 * half_length, 2 * half_width, 1.5, np.arctan2(forward[1], forward[0])])
    if not len(boxes):
        return np.zeros(0, bool)
    return footprints_overlap(ego, boxes)


def _signals(rng: np.random.Generator) -> dict[str, str]:
    active = PHASES[int(rng.integers(2))]
    state = str(rng.choice(["green", "amber", "red"], p=[0.7, 0.2, 0.1]))
    return {phase: state if phase == active else "red" for phase in PHASES}
