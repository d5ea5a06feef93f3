"""The script that makes the bundled edge refiner: what it shows the network, and that it trains."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from wibam_core.detection.crops import CROP_PX
from wibam_core.models.edge_refiner import EdgeRefinerNetwork
from wibam_core.models.export import export_edge_refiner
from wibam_core.pretraining import edge_refiner
from wibam_core.pretraining.common import PoolPlan, is_taught
from wibam_core.pretraining.edge_refiner import CropBatches, Patch, patches, sample
from wibam_core.synthetic.sampling import sample_views

SEED = 991_000
PLAN = PoolPlan(SEED, "elevated", 40, 20, 2, (640, 360))


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def test_patches_show_the_vehicles_and_know_both_boxes() -> None:
    found = patches(PLAN, 0, 20)
    views = list(sample_views(SEED, "elevated", 20, (640, 360)))
    taught = [(view, row) for view in views for row in np.flatnonzero(is_taught(view))]
    assert len(found) == len(taught) > 40
    for patch, (view, row) in zip(found, taught, strict=True):
        assert patch.vehicle_class == view.vehicles.classes[row]
        grown = (patch.whole - patch.seen) * [-1, -1, 1, 1]
        assert (grown > -1.5).all(), "what is seen lies within the whole"
        seen = view.visible_boxes[row]
        scale = (patch.seen[2:] - patch.seen[:2]) / (seen[2:] - seen[:2])
        assert (scale < 1.05).all()
        assert ((patch.seen[2:] - patch.seen[:2]) < 90).all()
    assert any((patch.whole - patch.seen)[2] > 5 for patch in found), "some are partly hidden"


def test_the_sizes_of_images_go_on_where_the_views_of_before_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    rendered: list[tuple[int, tuple[int, int]]] = []
    monkeypatch.setattr(
        PoolPlan, "views", lambda plan, first, count: rendered.append((first, plan.size_px)) or iter(())
    )
    patches(PLAN, 0, 80)
    at_once, rendered[:] = rendered[:], []
    for first in range(0, 80, 20):
        patches(PLAN, first, 20)
    assert rendered == at_once and {size for _, size in rendered} == set(edge_refiner.SIZES_PX)


def test_a_crop_keeps_the_edges_where_they_are_in_the_image() -> None:
    """A bright rectangle on a dark ground: its border in the crop lies where the labels say."""
    pixels = np.zeros((120, 160, 7), np.uint8)
    pixels[..., 6] = 255
    pixels[40:80, 50:110, :3] = 200
    seen = np.array([49.5, 39.5, 109.5, 79.5])
    patch = Patch(pixels, seen, seen + [0, 0, 12, 0], 0)
    for number in range(20):
        crop, edges, whole = sample(patch, np.random.default_rng(number))
        assert crop.shape == (7, CROP_PX, CROP_PX)
        light = cv2.GaussianBlur(crop[:3].mean(axis=0), (3, 3), 0)
        bright = light > (light.min() + light.max()) / 2
        columns, rows = (np.flatnonzero(bright.any(axis=axis)) for axis in (0, 1))
        found = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1]) / CROP_PX
        np.testing.assert_allclose(np.clip(edges, 0, 1), found, atol=0.03)
        longer = whole - edges
        assert np.isclose(np.abs(longer).max(), 12 / 60 * (edges[2] - edges[0]))
        assert longer[2] > 0 or longer[0] < 0, "mirrored with the image"


def test_what_spoils_an_image_spoils_its_background_alike_but_for_the_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing stands, a spoilt image is its spoilt background; the noise of one frame is in the image alone."""
    monkeypatch.setattr(edge_refiner, "_DEGRADED", 1.0)
    pixels = np.full((120, 160, 7), 255, np.uint8)
    pixels[..., :6] = np.tile(cv2.resize(np.arange(12, dtype=np.uint8).reshape(3, 4) * 20, (160, 120))[..., None], 6)
    box = np.array([49.5, 39.5, 109.5, 79.5])
    rough = []
    for number in range(40):
        crop, *_ = sample(Patch(pixels, box, box, 0), np.random.default_rng(number))
        known = crop[6] > 0.5
        if known.mean() > 0.9:
            assert abs(np.median((crop[:3] - crop[3:6])[:, known])) < 0.1
            image, still = (np.abs(np.diff(part, axis=2)).mean() for part in (crop[:3], crop[3:6]))
            rough.append(image / still)
    assert len(rough) > 20
    assert max(rough) > 1.5 and min(rough) > 0.8


def test_a_seed_gives_the_same_batches() -> None:
    first, again, other = (list(CropBatches(PLAN, 4, 3, seed)) for seed in (0, 0, 1))
    assert all(torch.equal(one.images, two.images) for one, two in zip(first, again, strict=True))
    assert not any(torch.equal(one.images, two.images) for one, two in zip(first, other, strict=True))
    assert not any(torch.equal(one.images, two.images) for one, two in itertools.combinations(first, 2))
    assert first[0].images.shape == (3, 7, CROP_PX, CROP_PX)


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_the_script_trains(device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("there is no CUDA device here")
    monkeypatch.setattr(edge_refiner, "VALIDATION_VIEWS", 20)
    words = ["--steps", "60", "--images", "20", "--batch", "4", "--checkpoint-every", "60", "--device", device]
    monkeypatch.setattr("sys.argv", ["script", "--out", str(tmp_path), *words])
    edge_refiner.main()
    training, validation = (json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines())
    assert (training["step"], validation["step"]) == (50, 60)
    assert np.isfinite(list(training.values())).all()
    for views in ("usual", "varied"):
        assert np.isfinite(list(validation[views].values())).all()
        assert 0 < validation[views]["hidden_share"] < 0.5
    torch.manual_seed(0)
    export_edge_refiner(EdgeRefinerNetwork(), tmp_path / "start", CROP_PX)
    assert (tmp_path / "start").read_bytes() != (tmp_path / "edge_refiner.onnx").read_bytes()
