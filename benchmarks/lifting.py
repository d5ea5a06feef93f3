"""Association and lifting against the truth of simulated sites.

2D boxes are the true visible ones with jitter, misses, false boxes and wrong classes, or what the bundled detector
finds; cameras have distortion and are exposed at different times. Prints, per seed: precision and recall of pairs of
boxes, the errors of the fits, and the seconds that one core is busy for a recording of 10 minutes.

Run: python benchmarks/lifting.py [--seeds 1 2 3] [--seconds 60] [--detector] [--cache build/lifting]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path

import cv2
import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from wibam_core.association.associate import associate, association_statistics
from wibam_core.config import AssociateConfig, LiftConfig
from wibam_core.detection.boxes import Found
from wibam_core.detection.detector import BUNDLED, Detector, load_detector
from wibam_core.formats.annotations import read_annotations, write_annotations
from wibam_core.formats.labels import read_labels, write_labels
from wibam_core.formats.rig import read_rig, write_rig
from wibam_core.geometry.box3d import SIZE, SIZE_XY, XY, YAW
from wibam_core.geometry.boxes2d import clipped_to_image, image_iou, sides_px
from wibam_core.geometry.iou import bev_iou_paired, iou_3d_paired
from wibam_core.lifting.lift import lift
from wibam_core.models.taught import TAUGHT
from wibam_core.road_users import CLASSES
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, LabelledInstant, MultiViewVehicle, Vehicles3D
from wibam_core.synthetic.cameras import site_cameras
from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.lighting import develop, sample_lighting, sample_photometry
from wibam_core.synthetic.render import Drawing, Renderer
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.traffic import simulate_traffic

RATE_HZ = 12.5
SIZE_PX = (640, 360)
JITTER = 0.02
JITTER_PX = 0.5
MISS_RATE = 0.03
FALSE_PER_IMAGE = 0.1
WRONG_CLASS_RATE = 0.03
MIN_VISIBILITY = 0.25
MIN_SIDE_PX = 8.0
MAX_LATE_NS = 40_000_000


@dataclass(frozen=True, eq=False)
class Site:
    """A simulated recording: true multi-view vehicles (``track_id`` is the true vehicle), and true boxes."""

    rig: CameraRig
    instants: list[AnnotatedInstant]
    truth: list[LabelledInstant]


def simulate(seed: int, seconds: float, folder: Path, detector: bool = False) -> Site:
    """Simulate, or read what was simulated before."""
    folder = folder / f"{seed}-{seconds:g}s{'-detector' if detector else ''}"
    if not (folder / "labels.parquet").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        site = _record(seed, seconds, load_detector(BUNDLED, min_score=0.3, nms_iou=0.6) if detector else None)
        write_rig(folder / "rig.json", site.rig)
        write_annotations(folder / "annotations.parquet", site.instants)
        write_labels(folder / "labels.parquet", site.truth)
    return Site(
        read_rig(folder / "rig.json"),
        read_annotations(folder / "annotations.parquet"),
        read_labels(folder / "labels.parquet"),
    )


def _record(seed: int, seconds: float, detector: Detector | None) -> Site:
    rng = np.random.default_rng([seed, 5])
    layout = make_layout(seed)
    cameras = site_cameras(layout, rng, 4, SIZE_PX, distortion=True)
    rig = CameraRig({f"cam{k + 1}": camera for k, camera in enumerate(cameras)})
    lighting, photometry = sample_lighting(rng), sample_photometry(rng)
    renderers = {camera_id: Renderer(layout, lighting, camera) for camera_id, camera in rig.items()}
    program = SignalProgram()
    traffic = simulate_traffic(layout, seed, seconds, program)
    late = {camera_id: int(rng.integers(-MAX_LATE_NS, MAX_LATE_NS)) for camera_id in rig}
    instants, truth = [], []
    for step in range(int(seconds * RATE_HZ)):
        time_ns = round(step * 1e9 / RATE_HZ)
        detections: dict[str, Detections2D] = {}
        views: dict[int, dict[str, int]] = {}
        present, boxes = traffic.at(time_ns * 1e-9)
        visibility = {camera_id: np.zeros(len(present)) for camera_id in rig}
        number = {t.vehicle_id: k for k, t in enumerate(present)}
        for camera_id in rig:
            frame_ns = max(0, time_ns + late[camera_id])
            there, frame_boxes = traffic.at(frame_ns * 1e-9)
            states = program.states(frame_ns * 1e-9)
            drawing = renderers[camera_id].draw([t.model for t in there], frame_boxes, states)
            for k, trajectory in enumerate(there):
                if trajectory.vehicle_id in number:
                    visibility[camera_id][number[trajectory.vehicle_id]] = drawing.visibility[k]
            if detector is None:
                owners, seen = _jittered(drawing, [t.model.vehicle_class.number for t in there], rng)
            else:
                owners, seen = _detected(drawing, detector.detect(develop(drawing.image, photometry, rng)))
            for row, k in enumerate(owners):
                if k >= 0 and there[k].vehicle_id in number:
                    views.setdefault(there[k].vehicle_id, {})[camera_id] = row
            detections[camera_id] = Detections2D(camera_id, frame_ns, *seen)
        vehicles = tuple(
            MultiViewVehicle(n, i, present[number[i]].model.vehicle_class, *boxes[number[i]][XY].tolist(), seen)
            for n, (i, seen) in enumerate(sorted(views.items()))
        )
        instants.append(AnnotatedInstant(time_ns, detections, vehicles))
        classes = np.array([t.model.vehicle_class.number for t in present], dtype=np.int64)
        true = Vehicles3D.of(time_ns, boxes, classes, np.array([t.vehicle_id for t in present], dtype=np.int64))
        truth.append(LabelledInstant(true, visibility))
    return Site(rig, instants, truth)


Seen = tuple[np.ndarray, np.ndarray, np.ndarray]


def _jittered(drawing: Drawing, classes: Sequence[int], rng: np.random.Generator) -> tuple[list[int], Seen]:
    """Owners (−1: none) and boxes, scores, classes of a detector that finds what is visible, inexactly."""
    owners, boxes, scores, labels = [], [], [], []
    for k, true_class in enumerate(classes):
        box = drawing.visible_boxes[k]
        sides = sides_px(box)
        if drawing.visibility[k] < MIN_VISIBILITY or sides.max() < MIN_SIDE_PX or rng.random() < MISS_RATE:
            continue
        noisy = box + rng.normal(0, np.hypot(JITTER_PX, JITTER * np.tile(sides, 2)))
        noisy = clipped_to_image(noisy, *SIZE_PX)
        noisy[2:] = np.maximum(noisy[2:], noisy[:2] + 1)
        owners.append(k)
        boxes.append(noisy)
        scores.append(rng.uniform(0.5, 1.0))
        labels.append(int(rng.integers(len(TAUGHT))) if rng.random() < WRONG_CLASS_RATE else true_class)
    for _ in range(rng.poisson(FALSE_PER_IMAGE)):
        corner = rng.uniform([0, 100], [SIZE_PX[0] - 60, SIZE_PX[1] - 40])
        owners.append(-1)
        boxes.append(np.concatenate([corner, corner + rng.uniform(15, 60) * np.array([1.0, 0.6])]))
        scores.append(rng.uniform(0.3, 0.6))
        labels.append(0)
    return owners, (np.array(boxes).reshape(-1, 4), np.array(scores), np.array(labels, dtype=np.int64))


def _detected(drawing: Drawing, found: Found) -> tuple[list[int], Seen]:
    """Owners (the visible box that overlaps most, by at least half) and boxes, scores, classes of a real detector."""
    overlap = image_iou(found.boxes, drawing.visible_boxes)
    owners = [-1] * len(found.boxes)
    if overlap.size:
        rows, columns = linear_sum_assignment(-overlap)
        for row, column in zip(rows, columns, strict=True):
            if overlap[row, column] >= 0.5:
                owners[row] = int(column)
    return owners, (found.boxes, found.scores, found.classes)


def pair_scores(true: Sequence[AnnotatedInstant], found: Sequence[AnnotatedInstant]) -> tuple[float, float]:
    """Precision and recall of pairs of boxes of different cameras said to show one vehicle."""
    right = said = there = 0
    for a, b in zip(true, found, strict=True):
        wanted, given = _pairs(a), _pairs(b)
        right += len(wanted & given)
        said += len(given)
        there += len(wanted)
    return right / max(said, 1), right / max(there, 1)


def _pairs(instant: AnnotatedInstant) -> set[frozenset[tuple[str, int]]]:
    return {frozenset(pair) for vehicle in instant.vehicles for pair in combinations(vehicle.views.items(), 2)}


@dataclass(frozen=True, eq=False)
class Matched:
    """Lifted boxes (N, 7) beside the true ones of the vehicle that most of their views show."""

    boxes: np.ndarray
    truth: np.ndarray
    sd: np.ndarray
    scores: np.ndarray
    classes: np.ndarray
    views: np.ndarray
    lost: int

    def where(self, keep: np.ndarray) -> Matched:
        parts = (self.boxes, self.truth, self.sd, self.scores, self.classes, self.views)
        return Matched(*(p[keep] for p in parts), self.lost)

    def yaw_error_deg(self) -> np.ndarray:
        return np.degrees(np.abs((self.boxes[:, YAW] - self.truth[:, YAW] + np.pi) % (2 * np.pi) - np.pi))

    def line(self, name: str) -> str:
        if not len(self.boxes):
            return f"{name:16s} none"
        iou = bev_iou_paired(self.boxes, self.truth)
        volume = iou_3d_paired(self.boxes, self.truth)
        ate = np.hypot(*(self.boxes - self.truth)[:, XY].T)
        small = np.minimum(self.boxes[:, SIZE_XY], self.truth[:, SIZE_XY]).prod(axis=1)
        ase = 1 - small / (self.boxes[:, SIZE_XY].prod(axis=1) + self.truth[:, SIZE_XY].prod(axis=1) - small)
        yaw = self.yaw_error_deg()
        ratio = np.exp(np.median(np.log(self.boxes[:, SIZE] / self.truth[:, SIZE]), axis=0))
        return (
            f"{name:16s} n {len(iou):5d}  BEV {iou.mean():.3f} (p10 {np.percentile(iou, 10):.2f})"
            f"  3D {volume.mean():.3f}  ATE {ate.mean():.3f} m  ASE {ase.mean():.3f}"
            f"  AOE {yaw.mean():.2f} (median {np.median(yaw):.2f})  size {ratio.round(3).tolist()}"
        )


def match(site: Site, associated: Sequence[AnnotatedInstant], lifted: Sequence[Vehicles3D]) -> Matched:
    """Compare each lifted vehicle with the true vehicle that most of its boxes show."""
    rows: list[tuple] = []
    lost = 0
    for true, mine, vehicles, label in zip(site.instants, associated, lifted, site.truth, strict=True):
        owner = {view: v.track_id for v in true.vehicles for view in v.views.items()}
        views_of = {v.track_id: v.views for v in mine.vehicles}
        box_of = dict(zip(label.vehicles.ids.tolist(), label.vehicles.boxes, strict=True))
        class_of = dict(zip(label.vehicles.ids.tolist(), label.vehicles.classes.tolist(), strict=True))
        for k, track in enumerate(vehicles.ids.tolist()):
            owners = [owner[view] for view in views_of[track].items() if view in owner]
            if not owners:
                lost += 1
                continue
            who = max(sorted(set(owners)), key=owners.count)
            rows.append(
                (vehicles.boxes[k], box_of[who], vehicles.sd[k], vehicles.scores[k], class_of[who], len(owners))
            )
    return Matched(*(np.array(column) for column in zip(*rows, strict=True)), lost)


def report(seed: int, site: Site) -> Matched:
    unassociated = [AnnotatedInstant(i.time_ns, i.detections) for i in site.instants]
    start = time.process_time()
    associated = associate(unassociated, site.rig, AssociateConfig())
    associate_s = time.process_time() - start
    start = time.process_time()
    result = lift(associated, site.rig, LiftConfig())
    lift_s = time.process_time() - start
    precision, recall = pair_scores(site.instants, associated)
    statistics = association_statistics(associated)
    print(f"seed {seed}: associate {associate_s:.1f} s, lift {lift_s:.1f} s CPU; {statistics}")
    print(f"  one core, 10 min of footage: {_per_ten_minutes(site, associate_s, lift_s)}")
    print(f"  pairs: precision {precision:.4f} recall {recall:.4f}; {result.statistics}")
    matched = match(site, associated, result.vehicles)
    print("  " + matched.line("all"))
    return matched


def _per_ten_minutes(site: Site, associate_s: float, lift_s: float) -> str:
    """CPU seconds, in proportion to the length of the recording."""
    share = 600.0 / (len(site.instants) / RATE_HZ)
    return f"associate {share * associate_s:.0f} s, lift {share * lift_s:.0f} s"


def breakdown(all_: Matched) -> None:
    print(all_.line("all"))
    for k, name in enumerate(CLASSES):
        print(all_.where(all_.classes == k).line(str(name)))
    for n in (1, 2, 3, 4):
        print(all_.where(all_.views == n).line(f"{n} view{'s' if n > 1 else ''}"))
    print(all_.where(all_.views > 1).line("several views"))
    edges = np.quantile(all_.scores, [0, 0.1, 0.25, 0.5, 0.75, 1])
    for low, high in pairwise(edges):
        print(all_.where((all_.scores >= low) & (all_.scores <= high)).line(f"score {low:.2f}-{high:.2f}"))
    known = all_.sd[:, YAW] < 1
    print(all_.where(known).line("front known"))
    print(all_.where(~known).line("front unknown"))
    error = all_.boxes - all_.truth
    error[:, YAW] = np.radians(all_.yaw_error_deg())
    z = np.percentile(np.abs(error / all_.sd), 68, axis=0)
    print("68th percentile of |error| / s.d. (x y z l w h yaw):", z.round(2).tolist(), "false vehicles:", all_.lost)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--detector", action="store_true", help="boxes of the bundled detector")
    parser.add_argument("--cache", type=Path, default=Path("build/lifting"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    matched = []
    for seed in arguments.seeds:
        matched.append(report(seed, simulate(seed, arguments.seconds, arguments.cache, arguments.detector)))
    fields = ("boxes", "truth", "sd", "scores", "classes", "views")
    whole = [np.concatenate([getattr(m, name) for m in matched]) for name in fields]
    breakdown(Matched(*whole, sum(m.lost for m in matched)))


if __name__ == "__main__":
    main()
