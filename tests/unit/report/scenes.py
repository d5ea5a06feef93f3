"""A painted crossroads with known traffic, as a start for tests of pictures."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from tests.builders import AMBIGUOUS, corner_rig
from tests.unit.report.documents import conflicts_json, metrics_json
from wibam_core.calibration.overlap import overlap_of
from wibam_core.documents.conflicts import Conflicts
from wibam_core.documents.metrics import Metrics
from wibam_core.documents.refinement import RefinedCamera, RefinedGround, Refinement
from wibam_core.documents.rounds import HeldOutAgreement, Round, Rounds, Source
from wibam_core.documents.statistics import SubsetStatistics
from wibam_core.geometry.box3d import corners
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane
from wibam_core.report.bev import BoxesInstant, ClusteredInstant
from wibam_core.report.charts import Bars, Curve, Delay, Histogram
from wibam_core.report.data import (
    CalibrationRow,
    ClockRow,
    Dataset,
    Example,
    Recording,
    ReportData,
    StageRow,
    Synchronisation,
    Training,
)
from wibam_core.report.mosaic import typical_image
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Track

SIZES = {
    RoadUserClass.CAR: (4.4, 1.8, 1.5),
    RoadUserClass.VAN: (5.4, 2.0, 2.2),
    RoadUserClass.TRUCK: (7.8, 2.5, 3.2),
    RoadUserClass.BUS: (11.8, 2.55, 3.1),
}
RATE_HZ = 5.0

REFINED = Refinement(
    method="traffic",
    taken=True,
    reason="the reprojection error of 40 vehicles, each held out in turn, went from 2.00 to 1.00 px at the median",
    vehicles=40,
    sightings=300,
    ground=RefinedGround(height_m=-0.25, slope_x=0.003, slope_y=0.004),
    cameras={
        name: RefinedCamera(
            turned_deg=0.31, moved_m=0.12, late_ms=-14.0, rotation_sd_deg=[0.1] * 3, position_sd_m=[0.05] * 3
        )
        for name in ("cam1", "cam2")
    },
)


def straight_track(
    track_id: int,
    vehicle_class: RoadUserClass,
    start: tuple[float, float],
    heading_rad: float,
    speed_mps: float,
    begin_s: float = 0.0,
    duration_s: float = 8.0,
) -> Track:
    """A vehicle that drives straight on at one speed."""
    times = begin_s + np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    direction = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    length, width, height = SIZES[vehicle_class]
    boxes = np.zeros((len(times), 7))
    boxes[:, :2] = np.array(start) + np.outer((times - begin_s) * speed_mps, direction)
    boxes[:, 2:] = height / 2, length, width, height, heading_rad
    velocities = np.tile(direction * speed_mps, (len(times), 1))
    return Track(
        track_id,
        vehicle_class,
        np.rint(times * 1e9).astype(np.int64),
        boxes,
        np.full((len(times), 7), 0.2),
        velocities,
        np.zeros(len(times)),
    )


def crossing_traffic() -> list[Track]:
    """Eastbound, westbound, northbound and southbound vehicles; tracks 1 and 3 meet near the middle."""
    east, north, west, south = 0.0, np.pi / 2, np.pi, -np.pi / 2
    return [
        straight_track(1, RoadUserClass.CAR, (-26.0, -2.0), east, 8.0),
        straight_track(2, RoadUserClass.BUS, (30.0, 2.0), west, 6.0),
        straight_track(3, RoadUserClass.VAN, (2.0, -24.0), north, 7.0),
        straight_track(4, RoadUserClass.TRUCK, (-2.0, 28.0), south, 5.0, begin_s=1.0),
        straight_track(5, RoadUserClass.CAR, (-36.0, -2.0), east, 8.0),
        straight_track(6, RoadUserClass.CAR, (2.0, -36.0), north, 9.0, begin_s=2.0),
    ]


def boxes_at(tracks: list[Track], time_ns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes (N, 7), class numbers (N,) and ids (N,) of the tracks that have a state at a time."""
    rows = [(t, int(np.searchsorted(t.times_ns, time_ns))) for t in tracks if time_ns in t.times_ns]
    boxes = np.array([t.boxes[i] for t, i in rows]).reshape(-1, 7)
    classes = np.array([t.vehicle_class.number for t, _ in rows], dtype=np.int64)
    return boxes, classes, np.array([t.track_id for t, _ in rows], dtype=np.int64)


def paint(camera: Camera, boxes: np.ndarray) -> np.ndarray:
    """(H, W, 3) BGR image of a crossroads with vehicles as solid boxes."""
    image = _crossroads(camera).copy()
    order = np.argsort(-np.linalg.norm(boxes[:, :3] - camera.centre_m, axis=1))
    for box in boxes[order]:
        uv, depth = camera.project(corners(box))
        if (depth > 0.5).all():
            shade = tuple(int(c) for c in np.random.default_rng(int(box[3] * 10)).integers(40, 220, 3))
            cv2.fillConvexPoly(image, cv2.convexHull(uv.astype(np.float32)).astype(np.int32), shade, cv2.LINE_AA)
    return image


@cache
def _crossroads(camera: Camera) -> np.ndarray:
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    ground = intersect_plane(camera, np.stack([u, v], axis=-1).astype(float))
    x, y = ground[..., 0], ground[..., 1]
    image = np.full((camera.height_px, camera.width_px, 3), (225, 205, 190), np.uint8)
    on_ground = np.isfinite(x) & (np.hypot(x, y) < 120)
    road = (np.abs(x) < 6) | (np.abs(y) < 6)
    mark = ((np.abs(x) < 0.15) & (np.abs(y) > 6)) | ((np.abs(y) < 0.15) & (np.abs(x) > 6))
    image[on_ground] = (90, 140, 105)
    image[on_ground & road] = (95, 92, 90)
    image[on_ground & mark] = (235, 235, 235)
    return image


def noisy(boxes: np.ndarray, scale: float, seed: int) -> np.ndarray:
    """Boxes (N, 7) as a network of a certain quality might predict them."""
    spread = np.array([1.0, 1.0, 0.05, 0.3, 0.1, 0.1, 0.2]) * scale
    return boxes + np.random.default_rng(seed).normal(size=boxes.shape) * spread


#: Number, source, boxes an image, vehicles that taught, and the share found.
_ROUNDS: tuple[tuple[int, Source, float, int | None, float], ...] = (
    (0, "detector", 3.0, None, 0.27),
    (1, "network", 7.0, 31, 0.83),
)


def report_data(*, labels: bool = True, site_name: str = "Elm Street / 4th Avenue") -> ReportData:
    """A whole report's data over the painted crossroads."""
    rig, tracks = corner_rig(4), crossing_traffic()
    ids = tuple(rig)
    times = [int(s * 1e9) for s in (1.0, 2.0, 3.0, 4.0)]
    pictures = {time: {c: paint(rig[c], boxes_at(tracks, time)[0]) for c in ids} for time in times}
    truth = {time: boxes_at(tracks, time)[0] for time in times}
    rng = np.random.default_rng(3)
    metrics = Metrics.model_validate(metrics_json(labels=labels))
    conflicts = Conflicts.model_validate(conflicts_json())
    return ReportData(
        site_name=site_name,
        version="0.1.0",
        warnings=(AMBIGUOUS,),
        rig=rig,
        recordings=tuple(Recording(c, "h264", 640, 360, 25.0, 600.0) for c in ids),
        synchronisation=Synchronisation(
            clocks=tuple(ClockRow(c, 0.3 * k, 0.003, 12.0 * k, 3.0, 24, 0.3 * k, 0.006) for k, c in enumerate(ids)),
            delays=tuple(
                Delay(c, t, 0.3 * k + 1.2e-5 * k * t, float(rng.normal(0, 0.006)))
                for k, c in enumerate(ids)
                for t in np.arange(10, 600, 45.0)
                if k
            ),
        ),
        calibration=tuple(
            CalibrationRow(
                c, "pnp", 12, 1, 0.61, 1.9, 0.04, 0.05, 0.11, {(0.0, 15.0): 0.04, (15.0, 30.0): 0.09, (30.0, 50.0): 0.2}
            )
            for c in ids
        ),
        rounds=Rounds(
            rounds=[
                Round(
                    number=number,
                    source=source,
                    boxes_an_image={"cam1": boxes, "cam2": boxes},
                    vehicles_an_instant={"1": 1.5, "2": boxes / 4, "3": 0.25},
                    views_a_vehicle=1.7,
                    taught_vehicles=taught,
                    agreement=HeldOutAgreement(
                        instants=60, sightings=40, iou=0.65, missed=60, found=found, an_instant=10 * found / 6
                    ),
                )
                for number, source, boxes, taught, found in _ROUNDS
            ],
            kept=1,
            reason="as many rounds as were asked for",
        ),
        overlap=overlap_of(rig),
        refinement=REFINED,
        dataset=Dataset(
            detected_boxes=12345,
            unassociated_share=0.17,
            single_view=210,
            subsets={
                name: SubsetStatistics(
                    instants=instants,
                    seconds=seconds,
                    vehicles=vehicles,
                    boxes=boxes,
                    tracks=tracks,
                    left_out_tracks=left,
                )
                for name, instants, seconds, vehicles, boxes, tracks, left in (
                    ("train", 1125, 450.0, 4000, 11000, 320, 4),
                    ("val", 225, 90.0, 800, 2100, 70, 2),
                    ("test", 150, 60.0, 500, 1400, 44, 0),
                )
            },
            plots=(
                Bars("vehicles by number of views", {"2": 3133, "3": 368, "4": 1074}),
                Bars("vehicles by class", {"car": 3000, "van": 800, "truck": 400, "bus": 120}),
                Histogram("depth of the boxes", "distance (m)", (0.0, 10.0, 20.0, 30.0, 40.0), (20, 900, 1100, 300)),
                Histogram("elevation angle", "angle (°)", (10.0, 20.0, 30.0, 40.0), (400, 900, 300)),
            ),
        ),
        training=Training(
            totals=(falling("training", 0.3), falling("validation", 0.5)),
            parts=(falling("heatmap", 0.1), falling("size", 0.2)),
            kept_step=400,
            facts=(("method", "lifted"), ("placing of boxes", "plane")),
        ),
        metrics=metrics,
        tracks=tuple(tracks),
        conflicts=tuple(conflicts.conflicts),
        conflict_thresholds=conflicts.thresholds,
        exposure=None,
        typical_images={c: typical_image([pictures[time][c] for time in times]) for c in ids},
        clusters=tuple(clustered(time / 1e9, truth[time], 4, seed=k) for k, time in enumerate(times)),
        boxes=tuple(
            BoxesInstant(
                time / 1e9,
                ({"label": truth[time]} if labels else {})
                | {"baseline": noisy(truth[time], 1.0, k), "fine-tuned": noisy(truth[time], 0.25, k)},
            )
            for k, time in enumerate(times[:2])
        ),
        examples=tuple(
            Example(
                time_s=time / 1e9,
                camera_id=ids[k],
                other_id=ids[(k + 2) % 4],
                cameras=rig,
                images=pictures[time],
                baseline=noisy(truth[time], 1.0, k),
                finetuned=noisy(truth[time], 0.25, k),
                labels=truth[time] if labels else None,
            )
            for k, time in enumerate(times[:2])
        ),
        stages=(
            StageRow("Check the recordings", "ab" * 32, 1.25),
            StageRow("Fine-tune the 3D detector", "cd" * 32, 118.4),
        ),
        options=(("safety.ttc_s", "3"),),
    )


def falling(name: str, floor: float) -> Curve:
    """A loss that levels out."""
    return Curve(name, tuple(range(50, 401, 50)), tuple(2 * np.exp(-np.arange(8) / 3) + floor))


def clustered(time_s: float, boxes: np.ndarray, cameras: int, seed: int) -> ClusteredInstant:
    """Every box seen by every camera, its ground points scattered."""
    points = np.tile(boxes[:, :2], (cameras, 1))
    return ClusteredInstant(
        time_s,
        points + np.random.default_rng(seed).normal(0, 0.5, points.shape),
        np.repeat(np.arange(cameras), len(boxes)),
        np.tile(np.arange(len(boxes)), cameras),
    )
