"""Edges of whole vehicles, from one image."""

import numpy as np
import pytest
import torch

from wibam_core.detection.background import StillBackground
from wibam_core.detection.boxes import Found
from wibam_core.detection.edge_refiner import EdgeRefiner
from wibam_core.models.second_look import SecondLook
from wibam_core.synthetic.sampling import RenderedView, sample_views


@pytest.fixture(scope="module")
def view() -> RenderedView:
    return next(sample_views(310_777, "site", 1, (960, 540)))


@pytest.fixture(scope="module")
def look() -> SecondLook:
    return SecondLook()


@pytest.fixture(scope="module")
def boxes(view: RenderedView) -> np.ndarray:
    """Of the whole vehicles (N, 4) that are seen at least in part."""
    return view.amodal_boxes[view.visibility > 0.3]


def rough(boxes: np.ndarray, seed: int = 0) -> np.ndarray:
    """Boxes whose edges are off by 8 % of their sides."""
    sides = np.tile(boxes[:, 2:] - boxes[:, :2], 2)
    return boxes + np.random.default_rng(seed).normal(0, 0.08, boxes.shape) * sides


def test_edges_become_exact_as_they_say(look: SecondLook, view: RenderedView, boxes: np.ndarray) -> None:
    sides = np.tile(boxes[:, 2:] - boxes[:, :2], 2)
    given = rough(boxes)
    seen = look.edges(view.image, given)
    sure = seen.sd_px.numpy() < 0.05 * sides
    assert sure.sum() > 12
    before, after = (np.abs(px - boxes)[sure] / sides[sure] for px in (given, seen.px.numpy()))
    assert after.mean() < 0.5 * before.mean()
    assert np.median(np.abs(seen.px.numpy() - boxes)[sure] / seen.sd_px.numpy()[sure]) < 2.0


def test_each_vehicle_is_looked_at_once(look: SecondLook, view: RenderedView, boxes: np.ndarray) -> None:
    """It takes half as long as the two looks of the 2D detector's boxes, which are farther off."""
    given = np.clip(rough(boxes), -0.5, np.array([960, 540, 960, 540]) - 0.5)
    found = Found(given, np.ones(len(given)), np.zeros(len(given), np.int64))
    unknown = StillBackground.unknown(*view.image.shape[:2])
    once, twice = (
        EdgeRefiner().refine(view.image, unknown, found, nms_iou=1.0, classify=False, passes=passes)
        for passes in (1, 2)
    )
    seen = look.edges(view.image, given)
    np.testing.assert_allclose(seen.px.numpy(), once.amodal_boxes, atol=1e-3)
    np.testing.assert_allclose(seen.sd_px.numpy(), once.amodal_sd, rtol=1e-3)
    assert np.abs(once.amodal_boxes - twice.amodal_boxes).max() > 0.1


def test_hidden_parts_belong_to_the_vehicle(look: SecondLook) -> None:
    """Edges that something hides are looked for behind it, not at its border."""
    whole, seen_part = [], []
    for view in sample_views(310_900, "site", 8, (960, 540)):
        chosen = view.visibility > 0.3
        boxes, visible = view.amodal_boxes[chosen], view.visible_boxes[chosen]
        sides = np.tile(visible[:, 2:] - visible[:, :2], 2)
        hidden = np.abs(boxes - visible) > 0.15 * sides
        found = look.edges(view.image, visible).px.numpy()
        whole.extend((np.abs(found - boxes) / sides)[hidden])
        seen_part.extend((np.abs(found - visible) / sides)[hidden])
    assert len(whole) > 10
    assert np.median(whole) < 0.9 * np.median(seen_part)


def test_the_answer_has_the_order_of_the_boxes(look: SecondLook, view: RenderedView, boxes: np.ndarray) -> None:
    given = rough(boxes)
    together = look.edges(view.image, given)
    turned = look.edges(view.image, given[::-1])
    torch.testing.assert_close(together.px, turned.px.flip(0), atol=1e-3, rtol=0)
    twice = look.edges(view.image, np.concatenate([given[:1], given[:1]]))
    assert twice.px.shape == (2, 4)


def test_what_cannot_be_looked_at_is_unsure(look: SecondLook, view: RenderedView, boxes: np.ndarray) -> None:
    good = boxes[0]
    bad = [
        (np.nan, 0.0, 50.0, 50.0),
        (0.0, 0.0, np.inf, 50.0),
        (-500.0, 20.0, -400.0, 90.0),  # out of the image
        (2000.0, 20.0, 2100.0, 90.0),
        (50.0, 50.0, 50.5, 90.0),  # no width
        (90.0, 50.0, 50.0, 90.0),
    ]
    seen = look.edges(view.image, np.array([good, *bad]))
    assert seen.sd_px[0].isfinite().all()
    assert torch.isinf(seen.sd_px[1:]).all() and seen.px.isfinite().all()
    alone = look.edges(view.image, good[None])
    torch.testing.assert_close(seen.px[0], alone.px[0], atol=1e-3, rtol=0)
    assert look.edges(view.image, np.array(bad)).sd_px.isinf().all()
    assert look.edges(view.image, np.zeros((0, 4))).px.shape == (0, 4)


def test_edges_stay_within_the_image(look: SecondLook, view: RenderedView) -> None:
    height, width = view.image.shape[:2]
    seen = look.edges(view.image, np.array([(-40.0, -40.0, 100.0, 100.0), (width - 60.0, height - 60.0, 9e3, 9e3)]))
    assert (seen.px >= -0.5).all()
    assert (seen.px <= torch.tensor([width - 0.5, height - 0.5] * 2)).all()
