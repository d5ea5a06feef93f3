"""Camera placements: street level ("ego"), poles at the corners ("site"), and any elevation ("elevated")."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.synthetic.layout import PARKING_M, Arm, Layout, SignalHead, road_distance_m

Array = NDArray[np.float64]

#: Focal length over image width of the cameras that street-level networks are trained for (nuScenes' front camera).
EGO_FOCAL = 0.79


def look(position: Array, heading_rad: float, pitch_rad: float, roll_rad: float = 0.0) -> SE3:
    """``T_world_cam`` of a camera at ``position`` (3,) that looks along ``heading_rad``, tilted up by ``pitch_rad``.

    A positive ``roll_rad`` turns the camera clockwise about its optical axis.
    """
    ch, sh, cp, sp = np.cos(heading_rad), np.sin(heading_rad), np.cos(pitch_rad), np.sin(pitch_rad)
    forward = np.array([ch * cp, sh * cp, sp])
    right = np.array([sh, -ch, 0.0])
    down = np.cross(forward, right)
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    return SE3(np.stack([c * right + s * down, c * down - s * right, forward], axis=1), position)


def look_at(position: Array, target: Array, roll_rad: float = 0.0) -> SE3:
    """``T_world_cam`` of a camera at ``position`` (3,) that looks at ``target`` (3,)."""
    d = np.asarray(target) - position
    return look(position, float(np.arctan2(d[1], d[0])), float(np.arctan2(d[2], np.hypot(d[0], d[1]))), roll_rad)


def intrinsics(focal: float, size_px: tuple[int, int], offset: tuple[float, float] = (0.0, 0.0)) -> Array:
    """(3, 3) matrix for a focal length in image widths; ``offset`` moves the principal point, in image widths."""
    w, h = size_px
    f = focal * w
    return np.array([[f, 0, (w - 1) / 2 + offset[0] * w], [0, f, (h - 1) / 2 + offset[1] * w], [0, 0, 1.0]])


def ego_camera(layout: Layout, rng: np.random.Generator, size_px: tuple[int, int]) -> Camera:
    """A street-level camera on a road, 1.2–3 m high, that mostly looks along its lane."""
    arm = layout.arms[rng.integers(len(layout.arms))]
    incoming = bool(rng.random() < 0.7)
    lanes = arm.incoming if incoming else arm.outgoing
    lateral = arm.lane_lateral_m(int(rng.integers(lanes)), incoming) + rng.normal(0, 0.5)
    along = float(rng.uniform(2.0, arm.stop_m + 38.0))
    height = float(np.clip(rng.gamma(6.0, 0.27), 1.2, 3.0))
    x, y = arm.point(along, lateral)
    heading = arm.heading_rad + (np.pi if incoming else 0.0)
    draw = rng.random()
    if draw < 0.55:
        turn = rng.normal(0, 0.18)
    elif draw < 0.85:
        turn = rng.uniform(-1.2, 1.2)
    else:
        turn = rng.uniform(-np.pi, np.pi)
    pitch = rng.normal(-0.03, 0.05)
    focal = EGO_FOCAL * rng.uniform(0.75, 1.25)
    pose = look(np.array([x, y, height]), heading + turn, pitch, rng.normal(0, 0.015))
    return Camera(intrinsics(focal, size_px), np.zeros(0), pose, *size_px)


def elevated_camera(layout: Layout, rng: np.random.Generator, size_px: tuple[int, int]) -> Camera:
    """A camera 2–14 m high anywhere around, looking roughly at the middle."""
    height = float(rng.uniform(2.0, 14.0))
    x = y = 0.0
    for _ in range(50):
        radius, angle = rng.uniform(9, 42), rng.uniform(-np.pi, np.pi)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        beside = road_distance_m(layout.arms, np.array([x, y])) > -1.0 or height > 4.5
        if beside and layout.is_free(x, y, 2.0):
            break
    spread = 9.0
    target = np.array([rng.normal(0, spread), rng.normal(0, spread), rng.uniform(-1, 2)])
    position = np.array([x, y, height])
    if np.hypot(*(target - position)[:2]) < 6.0:
        target = np.array([0.0, 0.0, 0.5])
    focal = rng.uniform(0.55, 1.15)
    pose = look_at(position, target, rng.normal(0, 0.03))
    offset = (float(rng.normal(0, 0.01)), float(rng.normal(0, 0.01)))
    return Camera(intrinsics(focal, size_px, offset), np.zeros(0), pose, *size_px)


def site_cameras(
    layout: Layout,
    rng: np.random.Generator,
    count: int,
    size_px: tuple[int, int],
    distortion: bool = False,
    height_m: tuple[float, float] = (6.0, 10.0),
) -> list[Camera]:
    """2–8 overlapping pole cameras behind the corners that look at the middle, with signal heads in view.

    With ``distortion`` each has a mild barrel distortion (k1, k2, p1, p2, k3).

    Raises:
        ValueError: for a count outside 2..8.
    """
    if not 2 <= count <= 8:
        raise ValueError(f"a site has 2 to 8 cameras, not {count}")
    corners = layout.corner_points()
    places = list(corners[np.argsort([_corner_rank(i, len(corners)) for i in range(len(corners))])])
    for arm in layout.arms:  # further poles stand beside the arms
        places.append(_roadside(arm, 1))
        places.append(_roadside(arm, -1))
    cameras: list[Camera] = []
    spare: list[Camera] = []  # cameras that see no signal head: only if there are not enough others
    for place in places:
        if len(cameras) == count:
            break
        tries: list[tuple[int, Camera]] = []
        for attempt in range(25):
            camera = _site_camera(layout, rng, place, size_px, distortion, height_m, 1.0 + 0.4 * attempt)
            tries.append((_phases_in_view(layout, camera), camera))
            if tries[-1][0] == 2:
                break
        phases, best = max(tries, key=lambda scored: scored[0])
        (cameras if phases else spare).append(best)
    return [*cameras, *spare][:count]


def _site_camera(
    layout: Layout,
    rng: np.random.Generator,
    place: Array,
    size_px: tuple[int, int],
    distortion: bool,
    height_m: tuple[float, float],
    beyond_m: float,
) -> Camera:
    """A camera near a place that looks at most ``beyond_m`` beyond the middle."""
    outward = place / np.linalg.norm(place)
    for _ in range(40):
        x, y = place + outward * rng.uniform(0.5, 3.5) + rng.normal(0, 0.6, 2)
        if layout.is_free(x, y, 1.5) and road_distance_m(layout.arms, np.array([x, y])) > 0.3:
            break
    position = np.array([x, y, rng.uniform(*height_m)])
    target = np.array([*(-outward * rng.uniform(0.0, beyond_m) + rng.normal(0, 1.0, 2)), 0.5])
    dist = np.zeros(0)
    if distortion:
        k1 = rng.uniform(-0.20, -0.08)
        dist = np.array([k1, -0.15 * k1, *rng.normal(0, 5e-4, 2), 0.0])
    focal = float(rng.uniform(0.50, 0.62))  # 78 to 90 degrees across, as action cameras on poles have
    offset = (float(rng.normal(0, 0.005)), float(rng.normal(0, 0.005)))
    pose = look_at(position, target, rng.normal(0, 0.01))
    return Camera(intrinsics(focal, size_px, offset), dist, pose, *size_px)


def heads_in_view(camera: Camera, heads: Sequence[SignalHead]) -> NDArray[np.bool_]:
    """Which heads (N,) are turned to the camera and wholly in its image (whatever may stand between)."""
    facing = np.array([h.facing_rad for h in heads])
    towards = camera.centre_m[:2] - np.array([[h.x_m, h.y_m] for h in heads])
    turned = towards[:, 0] * np.cos(facing) + towards[:, 1] * np.sin(facing)
    uv, depth = camera.project(np.array([h.outline(0.15) for h in heads]))
    inside = (depth > 1.0).all(axis=1) & camera.contains(uv).all(axis=1)
    return np.asarray(inside & (turned >= 0.3 * np.hypot(*towards.T)))


def _phases_in_view(layout: Layout, camera: Camera) -> int:
    seen = heads_in_view(camera, layout.signals)
    return len({head.phase for head, shown in zip(layout.signals, seen, strict=True) if shown})


def _corner_rank(i: int, count: int) -> float:
    """Opposite corners come first, so that two cameras already see vehicles from two sides."""
    return {0: 0, 1: 2, 2: 1, 3: 3}[i] if count == 4 else float(i)


def _roadside(arm: Arm, side: int) -> Array:
    edge = (arm.in_edge_m if side > 0 else -arm.out_edge_m) + (PARKING_M if arm.parking else 0) + 1.2
    return arm.point(arm.stop_m + 6.0, side * edge)
