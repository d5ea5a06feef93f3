"""How many of the labelled cars of one real roadside picture a detector has a box of.

Run: python -m benchmarks.roadside_picture FOLDER [--detector FILE.onnx]

The folder holds ``image_2.jpg`` and ``label_2.txt`` in KITTI's columns: those of the demo in
github.com/liyingying0113/rope3d-dataset-tools (commit 88859825), which are not part of this repository. A car
counts as found if a box overlaps its labelled one by an IoU of 0.5, each box for one car.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.detection.boxes import Image
from wibam_core.detection.detector import BUNDLED, load_detector
from wibam_core.evaluation.matching import assign
from wibam_core.geometry.boxes2d import image_iou

_NEAR_IOU, _LEAST_IOU = 0.3, 0.5


@dataclass(frozen=True)
class Found:
    """What a detector found: ``found`` of ``cars`` at IoU 0.5, ``mean_iou`` of these, ``further`` boxes that overlap
    no labelled car by 0.3. Vans and cars beyond the labels are further boxes, too."""

    cars: int
    found: int
    mean_iou: float
    further: int


def labelled_cars(labels: str) -> NDArray[np.float64]:
    """(N, 4) xyxy boxes of the cars of a label file, px."""
    rows = [line.split() for line in labels.splitlines()]
    return np.array([[float(value) for value in row[4:8]] for row in rows if row[0] == "car"]).reshape(-1, 4)


def count(image: Image, cars: NDArray[np.float64], detector: Path) -> Found:
    """What the detector in a file finds in the picture."""
    boxes = load_detector(detector, min_score=0.3, nms_iou=0.6).detect(image).boxes
    overlap = image_iou(boxes, cars)
    mine, theirs = assign(1 - overlap, 1 - _LEAST_IOU)
    further = int((overlap.max(axis=1, initial=0.0) < _NEAR_IOU).sum())
    mean = float(overlap[mine, theirs].mean()) if len(mine) else 0.0
    return Found(len(cars), len(mine), round(mean, 3), further)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--detector", type=Path, default=BUNDLED)
    typed = parser.parse_args()
    image = np.asarray(cv2.imread(str(typed.folder / "image_2.jpg")), np.uint8)
    cars = labelled_cars((typed.folder / "label_2.txt").read_text())
    print(json.dumps(asdict(count(image, cars, typed.detector))))


if __name__ == "__main__":
    main()
