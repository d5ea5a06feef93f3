"""The exported network and what runs it agree."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from wibam_core.detection.centre import CentreDetector
from wibam_core.detection.detector import load_detector
from wibam_core.models.detector2d import Detector2D, ExportedDetector2D
from wibam_core.models.export import export_detector2d


@pytest.fixture(scope="module")
def network() -> Detector2D:
    torch.manual_seed(3)
    network = Detector2D().eval()
    with torch.no_grad():
        network.heat.bias += 3.0  # an untrained network is sure of nothing
    return network


@pytest.mark.parametrize(("width", "height"), [(960, 540), (640, 480)])
def test_exported_detector_gives_the_networks_peaks(
    network: Detector2D, tmp_path: Path, width: int, height: int
) -> None:
    path = tmp_path / "detector.onnx"
    export_detector2d(network, path)
    detector = load_detector(path, min_score=0.5, nms_iou=1.0)
    assert isinstance(detector, CentreDetector)
    image = np.random.default_rng(1).integers(0, 255, (height // 8, width // 8, 3), dtype=np.uint8)
    image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC))
    found = detector.detect(image)

    content = round(height * 640 / width)
    small = cv2.resize(image, (640, content), interpolation=cv2.INTER_AREA)
    blob = np.zeros((-(-content // 32) * 32, 640, 3), np.float32)
    blob[:content] = small / 255.0
    with torch.inference_mode():
        heat, ltrb = ExportedDetector2D(network)(torch.from_numpy(blob).permute(2, 0, 1)[None])
    scores, at = heat[0].flatten().max(dim=0)
    number, row, column = np.unravel_index(int(at), heat[0].shape)
    sides = 4 * ltrb[0, :, row, column].numpy()
    centre = (np.array([column, row]) + 0.5) * 4 - 0.5
    box = (np.concatenate([centre - sides[:2], centre + sides[2:]]) + 0.5) * width / 640 - 0.5
    assert found.scores[0] == pytest.approx(float(scores), abs=1e-4)
    assert found.classes[0] == number
    assert np.allclose(found.boxes[0], np.clip(box, -0.5, np.array([width, height] * 2) - 0.5), atol=1e-2)
