"""A small traffic scene with exact geometry: bodies of parts, painted into an id image, visible boxes with jitter.

It is independent of `wibam_core.road_users`: bodies consist of convex parts that differ between vehicles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from tests.builders import corner_rig
from wibam_core.calibration.views import cut_view
from wibam_core.geometry.box3d import vehicle_to_world
from wibam_core.geometry.boxes2d import clipped_to_image
from wibam_core.geometry.camera import Camera
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, MultiViewVehicle, Vehicles3D
from wibam_core.site import ViewDirection

SIZES = {
    RoadUserClass.CAR: (4.4, 1.8, 1.5),
    RoadUserClass.VAN: (5.4, 2.0, 2.2),
    RoadUserClass.TRUCK: (7.8, 2.5, 3.2),
    RoadUserClass.BUS: (11.8, 2.55, 3.1),
    RoadUserClass.MOTORCYCLE: (2.1, 0.8, 1.6),
    RoadUserClass.BICYCLE: (1.75, 0.62, 1.75),
    RoadUserClass.PEDESTRIAN: (0.75, 0.6, 1.75),
}
#: Shares of vehicles in traffic.
_MOTOR_TRAFFIC = {RoadUserClass.CAR: 0.75, RoadUserClass.VAN: 0.12, RoadUserClass.TRUCK: 0.08, RoadUserClass.BUS: 0.05}


Points = list[tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class Actor:
    """One vehicle: class, size, convex parts of its body in the vehicle frame (m), and a path over time."""

    vehicle_class: RoadUserClass
    size: np.ndarray
    parts: tuple[np.ndarray, ...]
    path: np.ndarray  # (K, 2) polyline
    times_s: np.ndarray  # (M,)
    along_m: np.ndarray  # (M,) distance along the path at `times_s`

    def box(self, time_s: float) -> np.ndarray | None:
        """(7,) box, or None where the vehicle is not on its path."""
        if not self.times_s[0] <= time_s <= self.times_s[-1]:
            return None
        steps = np.linalg.norm(np.diff(self.path, axis=0), axis=1)
        arc = np.concatenate([[0.0], np.cumsum(steps)])
        s = np.interp(time_s, self.times_s, self.along_m)
        if not 0 <= s <= arc[-1]:
            return None
        at = np.array([np.interp(s, arc, self.path[:, k]) for k in (0, 1)])
        ahead, behind = ([np.interp(s + d, arc, self.path[:, k]) for k in (0, 1)] for d in (0.5, -0.5))
        way = np.subtract(ahead, behind)
        return np.array([*at, self.size[2] / 2, *self.size, np.arctan2(way[1], way[0])])


def body(vehicle_class: RoadUserClass, size: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Convex parts in the vehicle frame, m."""
    if vehicle_class is RoadUserClass.PEDESTRIAN:
        parts = _person(0.0, 0.5)
    elif vehicle_class in (RoadUserClass.BICYCLE, RoadUserClass.MOTORCYCLE):
        parts = _two_wheels(0.1 if vehicle_class is RoadUserClass.BICYCLE else 0.3)
    else:
        parts = _motor_vehicle(vehicle_class, rng)
    return tuple(np.array(part) * size - np.array([0, 0, size[2] / 2]) for part in parts)


def _person(low: float, half_stride: float) -> list[Points]:
    """Legs from the height ``low`` up, a trunk with arms, and a head."""
    hips = [(x, y, 0.52) for x in (0.2, -0.2) for y in (0.3, -0.3)]
    legs = [(half_stride, 0.15, low), (-half_stride, -0.15, low), *hips]
    trunk = [(x, y, z) for x in (0.25, -0.25) for y, z in ((0.42, 0.5), (0.5, 0.8), (-0.5, 0.8), (-0.42, 0.5))]
    head = [(x, y, z) for x in (0.15, -0.15) for y in (0.14, -0.14) for z in (0.86, 1.0)]
    return [legs, trunk, head]


def _two_wheels(half_width: float) -> list[Points]:
    """Two wheels and a frame, and who sits on it."""
    rims = [(-0.5, 0.2), (-0.3, 0.0), (0.3, 0.0), (0.5, 0.2), (0.3, 0.42), (-0.3, 0.42)]
    wheels = [(x, side * half_width, z) for x, z in rims for side in (1, -1)]
    bar = [(0.28, 0.5, 0.58), (0.28, -0.5, 0.58), (0.2, 0.5, 0.62), (0.2, -0.5, 0.62)]
    return [wheels, bar, *([(0.5 * x, y, z) for x, y, z in part] for part in _person(0.2, 0.3))]


def _motor_vehicle(vehicle_class: RoadUserClass, rng: np.random.Generator) -> list[Points]:
    """Convex parts: a chamfered hull on wheels, and a cabin or box that narrows upwards."""
    boxy = vehicle_class in (RoadUserClass.BUS, RoadUserClass.TRUCK)
    cut = rng.uniform(0.02, 0.04) if boxy else rng.uniform(0.05, 0.09)
    low, belt = (0.14, 0.5) if boxy else (rng.uniform(0.14, 0.22), rng.uniform(0.5, 0.6))
    outline = [(0.5, 0.5 - 2.5 * cut), (0.5 - cut, 0.5), (-0.5 + cut, 0.5), (-0.5, 0.5 - 2.5 * cut)]
    hull = [(x, s * y, z) for x, y in outline for s in (1, -1) for z in (low, belt)]
    wheels = [
        (x + dx, s * 0.48, z) for x in (0.3, -0.3) for s in (1, -1) for dx, z in ((-0.05, 0.02), (0, 0.0), (0.05, 0.02))
    ]
    if vehicle_class is RoadUserClass.CAR:
        front, rear, side = rng.uniform(0.05, 0.15), -rng.uniform(0.25, 0.42), rng.uniform(0.34, 0.4)
        cabin = [(front + 0.2, 0.45, belt), (rear - 0.07, 0.45, belt), (front, side, 1.0), (rear, side, 1.0)]
    elif vehicle_class is RoadUserClass.VAN:
        cabin = [(0.46, 0.47, belt), (-0.5, 0.48, belt), (rng.uniform(0.2, 0.3), 0.43, 1.0), (-0.48, 0.43, 1.0)]
    elif vehicle_class is RoadUserClass.TRUCK:
        cabin = [(0.22, 0.5, belt), (-0.5, 0.5, belt), (0.22, 0.5, 1.0), (-0.5, 0.5, 1.0)]
    else:
        cabin = [(0.5, 0.49, belt), (-0.5, 0.49, belt), (0.48, 0.45, 1.0), (-0.49, 0.45, 1.0)]
    parts = [hull, [*hull[:2], *wheels], [(x, s * y, z) for x, y, z in cabin for s in (1, -1)]]
    if vehicle_class is RoadUserClass.TRUCK:
        parts.append(
            [(x, s * 0.46, z) for x, z in ((0.5, belt), (0.26, belt), (0.47, 0.72), (0.26, 0.75)) for s in (1, -1)]
        )
    return parts


def _path(start: float, turn: float, lane_m: float) -> np.ndarray:
    """Comes in along heading ``start`` (rad), keeps right by ``lane_m``, turns by ``turn`` (rad) at the crossing."""
    if abs(turn) < 0.1:
        points = np.stack([np.linspace(-60, 60, 200), np.full(200, -lane_m)], axis=1)
    else:
        radius = 9.0 if turn > 0 else 6.0
        begin = np.array([-radius + (lane_m if turn > 0 else -lane_m), -lane_m])
        angles = np.linspace(0, turn, 40)
        side = np.sign(turn)
        arc = begin + radius * np.stack([np.sin(np.abs(angles)), side * (1 - np.cos(angles))], axis=1)
        lead = np.stack([np.linspace(-60, begin[0], 120), np.full(120, -lane_m)], axis=1)[:-1]
        away = arc[-1] + np.linspace(0.3, 50, 120)[:, None] * [np.cos(turn), np.sin(turn)]
        points = np.concatenate([lead, arc, away])
    c, s = np.cos(start), np.sin(start)
    return points @ np.array([[c, s], [-s, c]])


def _leader(rng: np.random.Generator, begin_s: float, stop_at_m: float, wait_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Drives up, waits at ``stop_at_m`` for ``wait_s`` (0: does not stop), drives off."""
    speed, dt, s, v = rng.uniform(7, 12), 0.05, 0.0, 0.0
    v, waited, out = speed, 0.0, []
    for _ in range(int(60 / dt)):
        target = speed
        if waited < wait_s:
            target = min(speed, np.sqrt(max(0.0, 2 * 2.5 * (stop_at_m - s))))
            if stop_at_m - s < 0.3:
                target, waited = 0.0, waited + dt
        v += np.clip(target - v, -3.5 * dt, 1.8 * dt)
        v = max(v, 0.0) if target else 0.0
        s += v * dt
        out.append(s)
    return begin_s + dt * np.arange(len(out)), np.array(out)


def traffic(seed: int, duration_s: float, *, start_s: float = -12.0) -> list[Actor]:
    """Platoons from four directions (Newell's followers: later by a headway and behind by a gap)."""
    rng = np.random.default_rng(seed)
    actors: list[Actor] = []
    clock, axis = start_s, 0
    while clock < duration_s:
        axis = 1 - axis
        for start in (axis * np.pi / 2, axis * np.pi / 2 + np.pi):
            for lane_m in (1.75, 5.25):
                turn = rng.choice([0.0, np.pi / 2 if lane_m < 2 else -np.pi / 2], p=[0.65, 0.35])
                path = _path(start, turn, lane_m)
                wait = 0.0 if rng.random() < 0.4 else rng.uniform(2, 6)
                times, along = _leader(rng, clock + rng.uniform(0, 2), 46.0, wait)
                gap = 0.0
                for n in range(rng.integers(1, 4)):
                    kind = rng.choice(np.array(list(_MOTOR_TRAFFIC), dtype=object), p=list(_MOTOR_TRAFFIC.values()))
                    size = np.array(SIZES[kind]) * np.exp(rng.normal(0, [0.07, 0.03, 0.05]))
                    gap += (size[0] / 2 + 2.0) if n else 0.0
                    actors.append(Actor(kind, size, body(kind, size, rng), path, times + 1.3 * n, along - gap))
                    gap += size[0] / 2
        clock += 13.0
    return actors


def people() -> list[Actor]:
    """Two who walk towards each other past one who stands, a cyclist each way and a motorcyclist."""
    rng = np.random.default_rng(3)
    times = np.arange(0, 60, 0.5)
    walks = {(-9.0, 9.0): 1.3, (9.0, 9.6): -1.4, (3.0, 7.6): 0.0}
    rides = {(-20.0, -3.0): (RoadUserClass.BICYCLE, 4.5), (20.0, 4.5): (RoadUserClass.BICYCLE, -5.0)}
    rides[-26.0, -6.5] = (RoadUserClass.MOTORCYCLE, 8.0)
    going = [(at, RoadUserClass.PEDESTRIAN, speed) for at, speed in walks.items()]
    going += [(at, kind, speed) for at, (kind, speed) in rides.items()]
    actors = []
    for (x, y), kind, speed in going:
        size = np.array(SIZES[kind]) * np.exp(rng.normal(0, [0.05, 0.05, 0.04]))
        way = np.array([[x, y], [x + (-100.0 if speed < 0 else 100.0), y]])
        actors.append(Actor(kind, size, body(kind, size, rng), way, times, 0.6 + abs(speed) * times))
    return actors


@dataclass(frozen=True, eq=False)
class Scene:
    """Annotated instants with the true multi-view vehicles (``track_id`` = actor), detections alone, and the truth."""

    rig: CameraRig
    instants: list[AnnotatedInstant]
    truth: list[Vehicles3D]

    @property
    def unassociated(self) -> list[AnnotatedInstant]:
        return [AnnotatedInstant(i.time_ns, i.detections) for i in self.instants]


def record(
    rig: CameraRig,
    actors: list[Actor],
    *,
    duration_s: float,
    rate_hz: float = 12.5,
    seed: int = 0,
    jitter: float = 0.02,
    miss_rate: float = 0.03,
    false_rate: float = 0.1,
    offset_ns: int = 0,
    class_error: float = 0.03,
) -> Scene:
    """See actors with all cameras.

    ``jitter`` is the s.d. of box edges as a share of the side (and 0.5 px); camera k's frames are exposed
    ``k · offset_ns`` after the instant; ``false_rate`` is the mean number of false boxes per image.
    """
    rng = np.random.default_rng(seed)
    instants, truth = [], []
    for step in range(int(duration_s * rate_hz)):
        time_ns = round(step * 1e9 / rate_hz)
        detections: dict[str, Detections2D] = {}
        views: dict[int, dict[str, int]] = {}
        for number, (camera_id, camera) in enumerate(rig.items()):
            frame_ns = time_ns + number * offset_ns
            present = [(k, a, a.box(frame_ns * 1e-9)) for k, a in enumerate(actors)]
            visible = _visible_boxes(camera, [(k, a, b) for k, a, b in present if b is not None])
            boxes, classes, scores = [], [], []
            for k, box in visible.items():
                if rng.random() < miss_rate:
                    continue
                sides = np.tile(box[2:] - box[:2], 2)
                noisy = box + rng.normal(0, np.hypot(0.5, jitter * sides))
                noisy = clipped_to_image(noisy, camera.width_px, camera.height_px)
                noisy[2:] = np.maximum(noisy[2:], noisy[:2] + 1)
                views.setdefault(k, {})[camera_id] = len(boxes)
                right = rng.random() >= class_error
                classes.append(actors[k].vehicle_class.number if right else rng.integers(len(_MOTOR_TRAFFIC)))
                scores.append(rng.uniform(0.5, 1.0))
                boxes.append(noisy)
            for _ in range(rng.poisson(false_rate)):
                at, side = rng.uniform([0, 0], [camera.width_px - 60, camera.height_px - 40]), rng.uniform(15, 60, 2)
                boxes.append(np.concatenate([at, at + side * [1, 0.6]]))
                classes.append(0)
                scores.append(rng.uniform(0.3, 0.6))
            detections[camera_id] = Detections2D(
                camera_id, frame_ns, np.array(boxes).reshape(-1, 4), np.array(scores), np.array(classes, dtype=np.int64)
            )
        now = {k: a.box(time_ns * 1e-9) for k, a in enumerate(actors)}
        vehicles = tuple(
            MultiViewVehicle(n, k, actors[k].vehicle_class, *now[k][:2], seen)
            for n, (k, seen) in enumerate(sorted(views.items()))
            if now[k] is not None
        )
        instants.append(AnnotatedInstant(time_ns, detections, vehicles))
        there = [k for k, b in now.items() if b is not None]
        truth.append(
            Vehicles3D.of(
                time_ns,
                np.array([now[k] for k in there]).reshape(-1, 7),
                np.array([actors[k].vehicle_class.number for k in there], dtype=np.int64),
                np.array(there, dtype=np.int64),
            )
        )
    return Scene(rig, instants, truth)


def _visible_boxes(camera, present, scale: float = 2.0, min_share: float = 0.25) -> dict[int, np.ndarray]:
    """Tight boxes of what the camera sees of each vehicle: painted far to near into an image of numbers."""
    shapes = []
    for k, actor, box in present:
        depth = camera.to_camera(box[:3])[2]
        if not 2.0 < depth < 80:
            continue
        hulls = []
        for part in actor.parts:
            uv, z = camera.project(vehicle_to_world(box, part))
            if (z < 0.5).any():
                hulls = []
                break
            hulls.append(cv2.convexHull(np.round((uv + 0.5) * scale * 16).astype(np.int32)[:, None]))
        if hulls:
            shapes.append((np.linalg.norm(camera.centre_m - box[:3]), k, hulls))
    size = np.array([round(camera.width_px * scale), round(camera.height_px * scale)])
    image = np.zeros(size[::-1], dtype=np.uint8)
    areas, corners = {}, {}
    for _, k, hulls in sorted(shapes, key=lambda s: -s[0]):
        points = np.concatenate(hulls)[:, 0] / 16
        low = np.clip(np.floor(points.min(axis=0)).astype(int) - 1, 0, size)
        high = np.clip(np.ceil(points.max(axis=0)).astype(int) + 2, 0, size)
        if (high <= low).any():
            continue
        alone = np.zeros((high - low)[::-1], dtype=np.uint8)
        for hull in hulls:
            cv2.fillConvexPoly(alone, hull - low.astype(np.int32) * 16, 1, shift=4)
            cv2.fillConvexPoly(image, hull, k % 255 + 1, shift=4)
        areas[k], corners[k] = int(alone.sum()), (low, high)
    found = {}
    for k, area in areas.items():
        low, high = corners[k]
        rows, columns = np.nonzero(image[low[1] : high[1], low[0] : high[0]] == k % 255 + 1)
        if len(rows) < max(min_share * area, 120 * scale):
            continue
        start, end = low + (columns.min(), rows.min()), low + (columns.max() + 1, rows.max() + 1)
        found[k] = np.concatenate([start, end]) / scale - 0.5
    return found


def wide_rig() -> CameraRig:
    """The cameras of `corner_rig` with fisheye lenses, each with two views side by side that show the middle."""
    mounted, views = {}, {}
    K = np.array([[260.0, 0, 399.5], [0, 260.0, 299.5], [0, 0, 1.0]])
    for camera_id, camera in corner_rig().items():
        wide = Camera(K, np.array([0.02, -0.01, 0.0, 0.0]), camera.T_world_cam, 800, 600, "fisheye")
        towards_deg = np.degrees(np.arctan2(*camera.T_world_cam.rotation[[1, 0], 2]))
        sides = [
            ViewDirection(azimuth_deg=towards_deg + turn, down_deg=24.0, across_deg=56.0) for turn in (28.0, -28.0)
        ]
        mounted[camera_id] = wide
        views[camera_id] = tuple(cut_view(wide, side, f"{camera_id}.{k}") for k, side in enumerate(sides, 1))
    return CameraRig(mounted, views)


@lru_cache(maxsize=1)
def wide_crossing(duration_s: float = 6.4) -> Scene:
    """The same traffic as `crossing`, in view of `wide_rig`; made once."""
    return record(wide_rig(), traffic(1, duration_s, start_s=-22.0), duration_s=duration_s, seed=1)


@lru_cache(maxsize=4)
def crossing(seed: int = 1, duration_s: float = 6.4, offset_ns: int = 10_000_000, jitter: float = 0.02) -> Scene:
    """A few seconds of traffic in view of four cameras; made once."""
    return record(
        corner_rig(),
        traffic(seed, duration_s, start_s=-22.0),
        duration_s=duration_s,
        seed=seed,
        offset_ns=offset_ns,
        jitter=jitter,
    )
