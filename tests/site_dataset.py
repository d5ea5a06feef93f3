"""A tiny site on disk, for tests of fine-tuning: flat images with painted rectangles where the vehicles are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.builders import look_at
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.documents.split import Split
from wibam_core.formats.framestore import FrameStore, FrameStoreWriter
from wibam_core.geometry.box3d import corners
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, MultiViewVehicle, Vehicles3D

PERIOD_NS = 400_000_000
LATENESS_NS = {"north": 0, "east": 20_000_000, "south": -10_000_000}


@dataclass(frozen=True, eq=False)
class TinySite:
    rig: CameraRig
    frames: FrameStore
    instants: list[AnnotatedInstant]
    lifts: list[Vehicles3D]


def tiny_rig() -> CameraRig:
    places = {"north": (0.0, 20.0, 6.0), "east": (20.0, 0.0, 6.0), "south": (2.0, -20.0, 7.0)}
    return CameraRig({name: look_at(at, focal_px=420.0, width_px=640, height_px=160) for name, at in places.items()})


def boxes_at(time_ns: int) -> np.ndarray:
    """(2, 7): one vehicle drives along +X at 5 m/s, one stands."""
    x = -4.0 + 5.0 * time_ns * 1e-9
    return np.array([[x, 1.0, 0.75, 4.4, 1.8, 1.5, 0.0], [2.0, -4.0, 1.0, 5.4, 2.0, 2.0, 1.6]])


def tiny_site(folder: Path, instants: int = 4) -> TinySite:
    rig = tiny_rig()
    rng = np.random.default_rng(0)
    annotated, lifts = [], []
    with FrameStoreWriter(folder, 95) as writer:
        for index in range(instants):
            time_ns = index * PERIOD_NS
            detections = {}
            for camera_id, camera in rig.items():
                frame_time = time_ns + LATENESS_NS[camera_id]
                uv, _ = camera.project(corners(boxes_at(frame_time)))
                seen = np.concatenate([uv.min(axis=1), uv.max(axis=1)], axis=1)
                image = rng.integers(90, 110, (camera.height_px, camera.width_px, 3), dtype=np.uint8)
                for number, (x0, y0, x1, y1) in enumerate(np.clip(seen, 0, 639).astype(int)):
                    image[y0:y1, x0:x1] = (40, 60 + 120 * number, 200)
                writer.add(camera_id, time_ns, frame_time, image)
                detections[camera_id] = Detections2D(
                    camera_id, frame_time, seen, np.array([0.9, 0.8]), np.array([0, 1])
                )
            vehicles = tuple(
                MultiViewVehicle(number, number + 7, kind, 0.0, 0.0, dict.fromkeys(rig, number))
                for number, kind in enumerate((RoadUserClass.CAR, RoadUserClass.VAN))
            )
            annotated.append(AnnotatedInstant(time_ns, detections, vehicles))
            sd = np.full((2, 7), 0.1)
            sd[1, 6] = 3.0  # the standing vehicle's front is unknown
            lifts.append(
                Vehicles3D.of(time_ns, boxes_at(time_ns), np.array([0, 1]), np.array([7, 8]), np.array([1.0, 0.5]), sd)
            )
        writer.close()
    return TinySite(rig, FrameStore(folder), annotated, lifts)


def give_tiny_site(folder: Path, left_out: frozenset[int] = frozenset()) -> StageFolders:
    """The tiny site as the stages before fine-tuning would give it; the training part leaves some tracks out."""
    folders = StageFolders(folder)
    site = tiny_site(folders.place(catalogue.FRAMES))
    folders.give(catalogue.RIG, site.rig)
    folders.give(catalogue.ANNOTATIONS, site.instants)
    folders.give(catalogue.FITS, site.lifts)
    times = tuple(instant.time_ns for instant in site.instants)
    subsets = {"train": times[:2], "val": times[2:3], "test": times[3:]}
    leaves_out = {"train": left_out, "val": frozenset[int](), "test": frozenset[int]()}
    folders.give(catalogue.SPLIT, Split(times_ns=subsets, left_out_tracks=leaves_out))
    return folders


def without_detection(instant: AnnotatedInstant, camera_id: str, row: int) -> AnnotatedInstant:
    """The instant, had the camera not found its vehicle of this row."""
    kept = np.arange(len(instant.detections[camera_id])) != row
    detections = {**instant.detections, camera_id: instant.detections[camera_id].where(kept)}
    vehicles = []
    for vehicle in instant.vehicles:
        views = {name: its - (name == camera_id and its > row) for name, its in vehicle.views.items()}
        if vehicle.views[camera_id] == row:
            del views[camera_id]
        vehicles.append(replace(vehicle, views=views))
    return replace(instant, detections=detections, vehicles=tuple(vehicles))
