"""How well vehicles are tracked, and how many conflicts noise adds or hides, on simulated traffic.

Detections are the truth with errors as a fine-tuned detector makes them: in proportion to the distance, half of
their variance lasting from frame to frame, some headings turned by 180°, misses and false boxes. No images are made.

    python benchmarks/tracking.py --seeds 0 1 2 3 --cameras 4

Of a simulated site that was rendered (`wibam simulate`, `wibam run`) ``--site`` judges the tracks of the last run by
its labels.

What HOTA would be if places, headings or sizes of the tracked boxes were those of the nearest true ones, says
``--parts``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wibam_core.artifacts.catalogue import TRACKS
from wibam_core.config import SafetyConfig, TrackConfig
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.formats.labels import read_labels
from wibam_core.geometry.box3d import SIZE, XY, YAW
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import CLASSES
from wibam_core.safety.conflicts import find_conflicts
from wibam_core.scene import Track, Vehicles3D
from wibam_core.stages.runner import SiteFolder, latest
from wibam_core.stages.store import StageStore
from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.traffic import Traffic, simulate_traffic
from wibam_core.tracking.hota import hota
from wibam_core.tracking.tracker import Tracker

Array = NDArray[np.float64]

PERIOD_NS = 160_000_000
RADIUS_M = 45.0
CAMERA_RANGE_M = 50.0
#: Standard deviations 25 m from the camera, in the order of a box.
ERROR_SD = np.array([0.4, 0.4, 0.05, 0.3, 0.1, 0.1, 0.12])
RECALL, FALSE_BOXES, TURNED = 0.85, 0.05, 0.04


class Detector:
    """A camera's detector with errors that last."""

    def __init__(self, camera_id: str, place: Array, rng: np.random.Generator) -> None:
        self.camera_id = camera_id
        self._place = place
        self._rng = rng
        self._lasting: dict[int, Array] = {}

    def detect(self, traffic: Traffic, instant_ns: int, frame_time_ns: int) -> Vehicles3D:
        rng = self._rng
        present, boxes = traffic.at(frame_time_ns * 1e-9)
        found, sd = [], []
        for vehicle, box in zip(present, boxes, strict=True):
            distance = float(np.hypot(*(box[XY] - self._place)))
            if distance > CAMERA_RANGE_M or np.hypot(*box[XY]) > RADIUS_M or rng.random() > RECALL:
                continue
            if vehicle.vehicle_id not in self._lasting or rng.random() < 0.05:
                self._lasting[vehicle.vehicle_id] = rng.normal(size=7)
            spread = ERROR_SD * np.array([distance / 25, distance / 25, 1, 1, 1, 1, 1])
            error = np.sqrt(0.5) * (self._lasting[vehicle.vehicle_id] + rng.normal(size=7))
            seen = box + error * spread
            seen[YAW] = normalise_angle(seen[YAW] + np.pi * (rng.random() < TURNED))
            found.append(seen)
            sd.append(spread)
        for _ in range(rng.poisson(FALSE_BOXES)):
            found.append(np.array([*rng.uniform(-40, 40, 2), 0.75, 4.5, 1.8, 1.5, rng.uniform(-3, 3)]))
            sd.append(ERROR_SD)
        n = len(found)
        return Vehicles3D.of(
            instant_ns,
            np.array(found).reshape(-1, 7),
            scores=rng.uniform(0.4, 0.9, n),
            sd=np.array(sd).reshape(-1, 7),
            camera_id=self.camera_id,
        )


def true_tracks(traffic: Traffic, instants: Sequence[int]) -> list[Track]:
    """Each vehicle's first unbroken stay near the middle."""
    rows: dict[int, list[tuple[int, Array]]] = {}
    for instant in instants:
        for vehicle, box in zip(*traffic.at(instant * 1e-9), strict=True):
            if np.hypot(*box[XY]) < RADIUS_M:
                rows.setdefault(vehicle.vehicle_id, []).append((instant, box))
    tracks = []
    for vehicle_id, states in rows.items():
        times = np.array([time for time, _ in states])
        end = int(np.argmax(np.append(np.diff(times) > PERIOD_NS, True))) + 1
        if end < 4:
            continue
        times, boxes = times[:end], np.array([box for _, box in states[:end]])
        seconds = times * 1e-9
        velocities = np.gradient(boxes[:, XY], seconds, axis=0)
        turning = np.gradient(np.unwrap(boxes[:, YAW]), seconds)
        tracks.append(Track(vehicle_id, CLASSES[0], times, boxes, np.full((end, 7), 0.02), velocities, turning))
    return tracks


def nearest_true(truth: Sequence[Track], found: Sequence[Track], within_m: float) -> list[Array]:
    """Of each found track's T states (T, 7) the nearest true box at that instant; NaN where none is so near."""
    at: dict[int, list[Array]] = {}
    for track in truth:
        for time_ns, box in zip(track.times_ns.tolist(), track.boxes, strict=True):
            at.setdefault(time_ns, []).append(box)
    every = []
    for track in found:
        nearest = np.full((len(track), 7), np.nan)
        for k, (time_ns, box) in enumerate(zip(track.times_ns.tolist(), track.boxes, strict=True)):
            near = min(at.get(time_ns, []), key=lambda true: float(np.hypot(*(true[XY] - box[XY]))), default=None)
            if near is not None and np.hypot(*(near[XY] - box[XY])) <= within_m:
                nearest[k] = near
        every.append(nearest)
    return every


def standardised_errors(truth: Sequence[Track], found: Sequence[Track]) -> Array:
    """(K, 7) errors of tracked states over their standard deviations, against the nearest true state within 2 m."""
    errors = []
    for track, nearest in zip(found, nearest_true(truth, found, 2.0), strict=True):
        error = track.boxes - nearest
        error[:, YAW] = normalise_angle(error[:, YAW])
        errors.append((error / track.sd)[np.isfinite(error[:, YAW])])
    return np.concatenate([np.empty((0, 7)), *errors])


def with_true(truth: Sequence[Track], found: Sequence[Track], columns: int | slice) -> list[Track]:
    """The found tracks with these columns of their boxes as of the nearest true ones within 4 m."""
    changed = []
    for track, nearest in zip(found, nearest_true(truth, found, 4.0), strict=True):
        boxes = track.boxes.copy()
        rows = np.isfinite(nearest[:, YAW])
        boxes[rows, columns] = nearest[rows, columns]
        changed.append(replace(track, boxes=boxes))
    return changed


def report_site(folder: Path) -> None:
    """Prints HOTA of the last run's tracks at a simulated site, near the middle, where its labels know the truth."""
    outputs = latest(SiteFolder.load(folder), StageStore(folder / "outputs"))
    labels = LabelTimeline(read_labels(folder / "labels.parquet"))
    found = [near for track in outputs.read(TRACKS) if (near := near_middle(track)) is not None]
    rows: dict[int, list[tuple[int, Array, int]]] = {}
    for time_ns in sorted({int(time_ns) for track in found for time_ns in track.times_ns}):
        label = labels.at(time_ns)
        if label is not None:
            of = label.vehicles
            for number, box, kind in zip(of.ids.tolist(), of.boxes, of.classes.tolist(), strict=True):
                rows.setdefault(number, []).append((time_ns, box, kind))
    truth = []
    for number, states in sorted(rows.items()):
        n, boxes = len(states), np.array([box for _, box, _ in states])
        times = np.array([time_ns for time_ns, _, _ in states])
        track = Track(number, CLASSES[states[0][2]], times, boxes, np.full((n, 7), 0.02), np.zeros((n, 2)), np.zeros(n))
        near = near_middle(track)
        if near is not None:
            truth.append(near)
    score = hota(truth, found)
    print(f"{len(truth)} vehicles, {len(found)} tracks: HOTA {score.hota:.3f}, DetA {score.det_a:.3f}, AssA "
          f"{score.ass_a:.3f}, LocA {score.loc_a:.3f}")  # fmt: skip


def near_middle(track: Track) -> Track | None:
    """What of a track lies within `RADIUS_M` of the middle; None: nothing."""
    near = np.hypot(*track.boxes[:, XY].T) < RADIUS_M
    if not near.any():
        return None
    return replace(
        track,
        times_ns=track.times_ns[near],
        boxes=track.boxes[near],
        sd=track.sd[near],
        velocities_mps=track.velocities_mps[near],
        yaw_rates_radps=track.yaw_rates_radps[near],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--parts", action="store_true", help="HOTA with true places, headings and sizes, too")
    parser.add_argument("--site", type=Path, default=None, help="a simulated site with a run; nothing else is done")
    arguments = parser.parse_args()
    if arguments.site:
        report_site(arguments.site)
        return
    print(
        "seed  true  tracks   HOTA   DetA   AssA   LocA  z xy  z yaw  conflicts true/tracked  vehicles  ms/instant"
        "  s conflicts"
    )
    for seed in arguments.seeds:
        traffic = simulate_traffic(make_layout(seed), seed, arguments.seconds, SignalProgram(22.0))
        instants = list(range(0, int(arguments.seconds * 1e9), PERIOD_NS))
        rng = np.random.default_rng(seed)
        angles = np.pi / 4 + np.arange(arguments.cameras) * np.pi / 2
        detectors = [Detector(f"cam{k}", 22 * np.array([np.cos(a), np.sin(a)]), rng) for k, a in enumerate(angles)]
        seen = []
        for instant in instants:
            exposed = {d.camera_id: max(instant + int(rng.uniform(-3e7, 3e7)), 0) for d in detectors}
            seen.append((instant, [d.detect(traffic, instant, exposed[d.camera_id]) for d in detectors], exposed))
        start = time.process_time()
        tracker = Tracker(TrackConfig())
        for instant, found, exposed in seen:
            tracker.step(instant, found, exposed)
        tracks = tracker.tracks()
        tracked = time.process_time()
        truth = true_tracks(traffic, instants)
        score = hota(truth, tracks)
        z = np.sqrt(np.mean(standardised_errors(truth, tracks) ** 2, axis=0))
        compared = time.process_time()
        conflicts = [len(find_conflicts(each, SafetyConfig())) for each in (truth, tracks)]
        done = time.process_time()
        states = sum(len(track) for track in tracks)
        print(
            f"{seed:4d} {len(truth):5d} {len(tracks):7d}  {score.hota:.3f}  {score.det_a:.3f}  {score.ass_a:.3f}"
            f"  {score.loc_a:.3f}  {z[:2].mean():4.2f}  {z[6]:5.2f}  {conflicts[0]:10d}/{conflicts[1]:<11d}"
            f"  {states / len(instants):8.1f}  {1e3 * (tracked - start) / len(instants):10.2f}"
            f"  {(done - compared) / 2:11.1f}",
            flush=True,
        )
        if arguments.parts:
            parts = {name: hota(truth, with_true(truth, tracks, of)).hota
                     for name, of in (("places", XY), ("headings", YAW), ("sizes", SIZE))}  # fmt: skip
            print("      with true " + ", ".join(f"{name} {value:.3f}" for name, value in parts.items()), flush=True)


if __name__ == "__main__":
    main()
