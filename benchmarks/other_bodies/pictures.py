"""What a detector finds in pictures of other bodies, drawn one by one: a quick look without recordings.

A detector is asked for vehicles that it sees half of, 12 px at the shorter side; a box that overlaps none that is seen
by an IoU of 0.3 is false.

Run: python -m benchmarks.other_bodies.pictures --seed 1 --models chosen [--detector FILE.onnx]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.other_bodies.light import Light, Sensor
from benchmarks.other_bodies.picture import Painter
from benchmarks.other_bodies.record import Plan, present
from benchmarks.other_bodies.surroundings import Surroundings
from wibam_core.detection.detector import BUNDLED, load_detector
from wibam_core.evaluation.matching import assign
from wibam_core.geometry.boxes2d import image_iou, sides_px

_LEAST_VISIBLE, _LEAST_PX, _FALSE_IOU = 0.5, 12.0, 0.3


@dataclass(frozen=True)
class Count:
    """Vehicles that were ``asked`` for and ``found`` at IoU 0.5, and ``false`` boxes."""

    asked: int
    found: int
    false: int

    @property
    def recall(self) -> float:
        return self.found / max(self.asked, 1)

    @property
    def precision(self) -> float:
        return self.found / max(self.found + self.false, 1)


def count(plan: Plan, times_s: Sequence[float], detector: Path = BUNDLED) -> Count:
    """What is found in the pictures of all cameras of a plan at some times."""
    vehicles = plan.traffic()
    surroundings = Surroundings(plan.crossing(), Light.sample(np.random.default_rng([plan.seed, 5])), plan.seed)
    loaded = load_detector(detector, min_score=0.3, nms_iou=0.6)
    asked = found = false = 0
    for number, camera in enumerate(plan.rig().values()):
        rng = np.random.default_rng([plan.seed, 6, number])
        painter, sensor = Painter(camera, surroundings), Sensor.sample(rng)
        for time_s in times_s:
            picture = painter.draw(*present(vehicles, time_s))
            boxes = loaded.detect(sensor.developed(picture.linear, rng)).boxes
            clear = picture.visibility >= _LEAST_VISIBLE
            clear &= sides_px(picture.visible_boxes).min(axis=1) >= _LEAST_PX
            _, matched = assign(1 - image_iou(boxes, picture.visible_boxes[clear]), 0.5)
            asked += int(clear.sum())
            found += len(matched)
            seen = picture.visible_boxes[picture.visibility > 0]
            false += int((image_iou(boxes, seen).max(axis=1, initial=0.0) < _FALSE_IOU).sum())
    return Count(asked, found, false)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--models", choices=("chosen", "held-out", "all"), default="chosen")
    parser.add_argument("--times", type=float, nargs="+", default=(5.0, 9.0, 15.0, 20.0, 25.0, 30.0, 35.0))
    parser.add_argument("--detector", type=Path, default=BUNDLED)
    typed = parser.parse_args()
    counted = count(Plan(typed.seed, typed.models, seconds=40.0), typed.times, typed.detector)
    print(f"{counted}: recall {counted.recall:.3f}, precision {counted.precision:.3f}")


if __name__ == "__main__":
    main()
