"""What is counted on a real roadside picture, and a floor for the bundled detector on it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from benchmarks.roadside_picture import count, labelled_cars
from wibam_core.detection.detector import BUNDLED


def test_cars_alone_are_read() -> None:
    lines = ["car 0 0 1.5 10 20 30 40 1 2 3 4 5 6 7", "trafficcone 0 0 1.5 1 2 3 4 1 2 3 4 5 6 7"]
    assert labelled_cars("\n".join(lines)).tolist() == [[10, 20, 30, 40]]
    assert labelled_cars("").shape == (0, 4)


def test_the_bundled_detector_finds_cars_in_a_real_picture(assets: Path) -> None:
    folder = assets / "roadside"
    image = np.asarray(cv2.imread(str(folder / "image_2.jpg")), np.uint8)
    cars = labelled_cars((folder / "label_2.txt").read_text())
    assert len(cars) == 15
    nothing = count(np.zeros_like(image), cars, BUNDLED)
    assert (nothing.found, nothing.further) == (0, 0)
    assert count(image, cars, BUNDLED).found >= 4  # 5 when this was written; 0 of the detector before, 9 of YOLOX-nano
