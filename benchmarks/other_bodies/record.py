"""Record a site of other bodies: what `wibam run` takes, with exact labels.

Run: python -m benchmarks.other_bodies.record SITE --seed 1 --models chosen [--seconds 48 --fps 6.25]
"""

from __future__ import annotations

import argparse
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from benchmarks.other_bodies.catalogue import MODELS
from benchmarks.other_bodies.driving import Crossing, Vehicle, drive
from benchmarks.other_bodies.light import Light, Sensor
from benchmarks.other_bodies.picture import Painter, Picture
from benchmarks.other_bodies.surroundings import Surroundings
from wibam_core.formats.labels import write_labels
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3, normalise_angle
from wibam_core.scene import LabelledInstant, Vehicles3D, site_camera
from wibam_core.site import Site
from wibam_core.video.encode import VideoWriter

Array = NDArray[np.float64]

_SIDES = ("x0", "y0", "x1", "y1")


@dataclass(frozen=True)
class Plan:
    """A recording: everything follows from it.

    Attributes:
        seed: of roads, traffic, light, cameras and looks. models: "chosen", "held-out" or "all".
        seconds, fps, width_px, height_px: of every camera's recording. cameras: how many.
        arms: of the crossing. parked: vehicles that stand beside the road. per_minute: new vehicles a minute and arm.
    """

    seed: int
    models: str = "all"
    seconds: float = 48.0
    fps: float = 6.25
    width_px: int = 640
    height_px: int = 360
    cameras: int = 4
    arms: int = 4
    parked: int = 2
    per_minute: float = 9.0

    def times_ns(self) -> list[int]:
        return [round(k * 1e9 / self.fps) for k in range(int(self.seconds * self.fps))]

    def crossing(self) -> Crossing:
        return Crossing.sample(np.random.default_rng([self.seed, 1]), self.arms, self.parked)

    def traffic(self) -> list[Vehicle]:
        wanted = {"chosen": (False,), "held-out": (True,), "all": (False, True)}[self.models]
        models = tuple(model for model in MODELS if model.held_out in wanted)
        return drive(self.crossing(), models, self.seconds, self.per_minute, np.random.default_rng([self.seed, 2]))

    def rig(self) -> dict[str, Camera]:
        """Cameras on poles between the arms that look at the middle."""
        rng = np.random.default_rng([self.seed, 4])
        arms = np.sort(np.mod(self.crossing().arms_rad, 2 * np.pi))
        corners = arms + np.mod(np.roll(arms, -1) - arms, 2 * np.pi) / 2
        found = {}
        for k in range(self.cameras):
            angle = corners[k % len(corners)] + rng.normal(0, 0.06)
            radius = rng.uniform(15, 19)
            place = np.array([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(5.5, 9.0)])
            aim = np.array([*rng.normal(0, 2.0, 2), 0.0]) - 0.12 * np.array([*place[:2], 0.0])
            focal = self.width_px * rng.uniform(0.52, 0.72)
            K = np.array([[focal, 0, (self.width_px - 1) / 2], [0, focal, (self.height_px - 1) / 2], [0, 0, 1.0]])
            found[f"cam{k + 1}"] = Camera(K, np.zeros(0), _looking(place, aim), self.width_px, self.height_px)
        return found


def _looking(place: Array, aim: Array) -> SE3:
    forward = (aim - place) / np.linalg.norm(aim - place)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return SE3(np.stack([right, np.cross(forward, right), forward], axis=1), place)


def present(vehicles: list[Vehicle], time_s: float) -> tuple[list[Vehicle], list[Array]]:
    """Who is there at a time, and the poses (x, y, yaw)."""
    there = [(vehicle, pose) for vehicle in vehicles if (pose := vehicle.pose_at(time_s)) is not None]
    return [vehicle for vehicle, _ in there], [pose for _, pose in there]


def _record_camera(
    plan: Plan, vehicles: list[Vehicle], camera_id: str, path: Path
) -> list[tuple[int, list[int], Picture]]:
    cv2.setNumThreads(1)
    number = list(plan.rig()).index(camera_id)
    rng = np.random.default_rng([plan.seed, 6, number])
    light = Light.sample(np.random.default_rng([plan.seed, 5]))
    painter = Painter(plan.rig()[camera_id], Surroundings(plan.crossing(), light, plan.seed))
    sensor = Sensor.sample(rng)
    found = []
    with VideoWriter(path, plan.width_px, plan.height_px, plan.fps, crf=23) as writer:
        for time_ns in plan.times_ns():
            there, poses = present(vehicles, time_ns * 1e-9)
            picture = painter.draw(there, poses)
            writer.write(sensor.developed(picture.linear, rng), time_ns)
            found.append((time_ns, [v.vehicle_id for v in there], picture))
    return [(t, ids, Picture(np.zeros((0, 0, 3), np.float32), *_truth(p))) for t, ids, p in found]


def _truth(picture: Picture) -> tuple[Array, Array, Array]:
    return picture.visible_boxes, picture.amodal_boxes, picture.visibility


def record(folder: Path, plan: Plan, workers: int = 1) -> None:
    """Write ``site.json``, ``recordings/``, ``labels.parquet`` and ``truth/boxes2d.parquet``; models' names go to
    ``truth/models.parquet``."""
    (folder / "recordings").mkdir(parents=True, exist_ok=True)
    (folder / "truth").mkdir(exist_ok=True)
    rig, vehicles = plan.rig(), plan.traffic()
    paths = [folder / "recordings" / f"{camera_id}.mp4" for camera_id in rig]
    # begun anew, not forked: a fork of a process with OpenCV's threads may wait for one of them for ever
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        seen = list(pool.map(_record_camera, [plan] * len(rig), [vehicles] * len(rig), rig, paths))
    site = Site(name=f"Other bodies {plan.seed}", cameras=tuple(site_camera(i, camera) for i, camera in rig.items()))
    (folder / "site.json").write_text(site.model_dump_json(indent=1) + "\n", encoding="utf-8")
    instants = []
    for k, time_ns in enumerate(plan.times_ns()):
        there, poses = present(vehicles, time_ns * 1e-9)
        boxes = np.array([_box(v, pose) for v, pose in zip(there, poses, strict=True)]).reshape(-1, 7)
        classes = np.array([v.model.vehicle_class.number for v in there], np.int64)
        ids = np.array([v.vehicle_id for v in there], np.int64)
        shown = {camera_id: seen[c][k][2].visibility for c, camera_id in enumerate(rig)}
        instants.append(LabelledInstant(Vehicles3D.of(time_ns, boxes, classes, ids), shown))
    write_labels(folder / "labels.parquet", instants)
    rows = [
        {"camera_id": camera_id, "time_ns": time_ns, "vehicle_id": who, "visibility": picture.visibility[n]}
        | {f"visible_{side}": picture.visible_boxes[n, s] for s, side in enumerate(_SIDES)}
        | {f"amodal_{side}": picture.amodal_boxes[n, s] for s, side in enumerate(_SIDES)}
        for camera_id, frames in zip(rig, seen, strict=True)
        for time_ns, ids, picture in frames
        for n, who in enumerate(ids)
        if picture.amodal_boxes[n, 2] > picture.amodal_boxes[n, 0]
    ]
    pq.write_table(pa.Table.from_pylist(rows), folder / "truth" / "boxes2d.parquet")
    names = {"vehicle_id": [v.vehicle_id for v in vehicles], "model": [v.model.name for v in vehicles]}
    pq.write_table(pa.table(names), folder / "truth" / "models.parquet")


def _box(vehicle: Vehicle, pose: Array) -> Array:
    size = (vehicle.model.length_m, vehicle.model.width_m, vehicle.model.height_m)
    return np.array([pose[0], pose[1], size[2] / 2, *size, float(normalise_angle(pose[2]))])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("site", type=Path)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--models", choices=("chosen", "held-out", "all"), default="all")
    parser.add_argument("--seconds", type=float, default=48.0)
    parser.add_argument("--fps", type=float, default=6.25)
    parser.add_argument("--arms", type=int, default=4)
    parser.add_argument("--width-px", type=int, default=640)
    parser.add_argument("--workers", type=int, default=1)
    typed = parser.parse_args()
    plan = Plan(
        typed.seed, typed.models, typed.seconds, typed.fps, typed.width_px, typed.width_px * 9 // 16, arms=typed.arms
    )
    record(typed.site, plan, typed.workers)


if __name__ == "__main__":
    main()
