"""The exported detector computes what the network does."""

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from wibam_core.models.detector2d import Detector2D, ExportedDetector2D
from wibam_core.models.edge_refiner import EdgeRefinerNetwork
from wibam_core.models.export import export_detector2d, export_edge_refiner
from wibam_core.models.taught import TAUGHT
from wibam_core.models.trunk import TrunkShape


@pytest.mark.filterwarnings("error::DeprecationWarning", "ignore::UserWarning")
def test_the_onnx_file_agrees_with_the_network_at_any_size(tmp_path: Path) -> None:
    torch.manual_seed(0)
    torch.set_num_threads(1)
    detector = Detector2D(TrunkShape(channels=(8, 8, 16, 16, 16), blocks=(0, 1, 0, 0), neck=8)).eval()
    torch.nn.init.normal_(detector.heat.get_parameter("weight"), std=0.5)
    path = tmp_path / "detector.onnx"
    export_detector2d(detector, path, 128, 64)
    assert [file.name for file in tmp_path.iterdir()] == ["detector.onnx"]
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    properties = session.get_modelmeta().custom_metadata_map
    assert properties["family"] == "wibam-centre"
    assert json.loads(properties["classes"]) == [str(c) for c in TAUGHT]
    for height, width in ((64, 128), (96, 160)):
        image = np.random.default_rng(1).random((1, 3, height, width), dtype=np.float32)
        heat, ltrb = session.run(["heat", "ltrb"], {"image": image})
        with torch.inference_mode():
            expected_heat, expected_ltrb = ExportedDetector2D(detector)(torch.from_numpy(image))
        assert heat.shape == (1, len(TAUGHT), height // 4, width // 4)
        # peaks of nearly equal height may be broken differently: compare what survives in both
        both = (heat > 0) & (expected_heat.numpy() > 0)
        assert both.sum() > 0.95 * (heat > 0).sum()
        np.testing.assert_allclose(heat[both], expected_heat.numpy()[both], atol=1e-4)
        np.testing.assert_allclose(ltrb, expected_ltrb.numpy(), rtol=1e-3)
        assert (ltrb > 0).all()


@pytest.mark.filterwarnings("error::DeprecationWarning", "ignore::UserWarning")
def test_the_exported_refiner_agrees_with_the_network_for_any_number_of_crops(tmp_path: Path) -> None:
    torch.manual_seed(0)
    refiner = EdgeRefinerNetwork().eval()
    path = tmp_path / "refiner.onnx"
    export_edge_refiner(refiner, path, 96)
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    assert session.get_modelmeta().custom_metadata_map["family"] == "wibam-edges"
    for count in (1, 5):
        crops = torch.rand(count, 7, 96, 96)
        with torch.inference_mode():
            wanted = refiner(crops)
        given = session.run(["edges", "reach", "log_scale", "classes"], {"image": crops.numpy()})
        for mine, theirs in zip(given, wanted, strict=True):
            np.testing.assert_allclose(mine, theirs.numpy(), atol=1e-4)
