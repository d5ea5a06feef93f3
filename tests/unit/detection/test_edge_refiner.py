"""The bundled edge refiner on rendered views of sites that it was not trained on."""

import numpy as np
import pytest

from wibam_core.detection.background import StillBackground
from wibam_core.detection.boxes import Found
from wibam_core.detection.edge_refiner import EdgeRefiner
from wibam_core.road_users import RoadUserClass
from wibam_core.synthetic.sampling import RenderedView, sample_views

SIDE_PX = 14.0
OPTIONS = {"nms_iou": 1.0, "classify": True}


@pytest.fixture(scope="module")
def views() -> list[RenderedView]:
    return list(sample_views(41, "site", 6, (640, 360)))


def shaken(view: RenderedView, rng: np.random.Generator) -> tuple[np.ndarray, Found]:
    """The true visible boxes of vehicles in plain sight, and the same with edges off by 8 % of their sides."""
    boxes = view.visible_boxes
    plain = (view.visibility > 0.6) & ((boxes[:, 2:] - boxes[:, :2]).min(axis=1) >= SIDE_PX)
    true = boxes[plain]
    wrong = true + rng.normal(0, 0.08, true.shape) * np.tile(true[:, 2:] - true[:, :2], 2)
    wrong = np.clip(wrong, -0.5, np.array([640, 360] * 2) - 0.5)
    return true, Found(wrong, np.ones(len(true)), np.zeros(len(true), np.int64))


def errors(views: list[RenderedView], known: bool) -> tuple[float, float]:
    """Mean error of the edges in shares of their boxes' sides before and after."""
    rng = np.random.default_rng(0)
    refiner = EdgeRefiner()
    before, after = [], []
    for view in views:
        true, given = shaken(view, rng)
        mask = np.full(view.image.shape[:2], 255 if known else 0, np.uint8)
        still = view.still if known else np.full_like(view.still, 128)
        found = refiner.refine(view.image, StillBackground(still, mask), given, nms_iou=1.0, classify=True)
        sides = np.tile(true[:, 2:] - true[:, :2], 2)
        before.append(np.abs(given.boxes - true) / sides)
        after.append(np.abs(found.boxes - true) / sides)
        assert found.boxes.shape == given.boxes.shape
        np.testing.assert_array_equal(found.scores, given.scores)
    return float(np.concatenate(before).mean()), float(np.concatenate(after).mean())


def test_edges_become_sharper_and_the_background_helps(views: list[RenderedView]) -> None:
    before, with_background = errors(views, known=True)
    _, without = errors(views, known=False)
    assert with_background < 0.45 * before
    assert with_background < without < before


def test_it_reaches_for_what_is_hidden_and_says_how_uncertain_that_is(views: list[RenderedView]) -> None:
    rng = np.random.default_rng(3)
    refiner = EdgeRefiner()
    seen, whole, sd, hidden = [], [], [], []
    for view in [*views, *sample_views(42, "site", 10, (640, 360))]:
        boxes = view.visible_boxes
        sides = np.tile(boxes[:, 2:] - boxes[:, :2], 2)
        enough = (view.visibility > 0.3) & (sides.min(axis=1) >= SIDE_PX)
        boxes, sides = boxes[enough], sides[enough]
        wrong = np.clip(boxes + rng.normal(0, 0.04, boxes.shape) * sides, -0.5, np.array([640, 360] * 2) - 0.5)
        given = Found(wrong, np.ones(len(boxes)), np.zeros(len(boxes), np.int64))
        background = StillBackground(view.still, np.full(view.image.shape[:2], 255, np.uint8))
        found = refiner.refine(view.image, background, given, **OPTIONS)
        true = view.amodal_boxes[enough]
        seen.append(np.abs(boxes - true) / sides)
        whole.append(np.abs(found.amodal_boxes - true) / sides)
        sd.append(found.amodal_sd / sides)
        hidden.append(seen[-1] > 0.08)
        assert (found.amodal_sd > 0).all()
    behind = np.concatenate(hidden)
    of_seen, of_whole, stated = (np.concatenate(parts) for parts in (seen, whole, sd))
    assert behind.sum() > 20
    assert of_whole[behind].mean() < 0.6 * of_seen[behind].mean()
    assert of_whole[~behind].mean() < 0.05
    assert stated[behind].mean() > 2 * stated[~behind].mean()
    assert 0.5 < (of_whole / stated)[behind].mean() < 1.3


def test_no_boxes_are_no_boxes(views: list[RenderedView]) -> None:
    none = Found(np.empty((0, 4)), np.empty(0), np.empty(0, np.int64))
    image = views[0].image
    found = EdgeRefiner().refine(image, StillBackground(image, image[..., 0]), none, **OPTIONS)
    assert found.boxes.shape == found.amodal_boxes.shape == found.amodal_sd.shape == (0, 4)


def test_boxes_stay_sound_whatever_the_image_shows(views: list[RenderedView]) -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)
    corners = rng.uniform(-0.5, [70, 50], (40, 2))
    boxes = np.concatenate([corners, np.minimum(corners + rng.uniform(1, 30, (40, 2)), [79.5, 59.5])], axis=1)
    background = StillBackground(np.full_like(image, 128), np.zeros((60, 80), np.uint8))
    found = EdgeRefiner().refine(image, background, Found(boxes, np.ones(40), np.zeros(40, np.int64)), **OPTIONS)
    assert (found.boxes[:, 2:] - found.boxes[:, :2] >= 1.0).all()
    assert (found.boxes >= -0.5).all() and (found.boxes <= [79.5, 59.5, 79.5, 59.5]).all()
    assert ((found.classes >= 0) & (found.classes < 4)).all()
    sides = np.tile(boxes[:, 2:] - boxes[:, :2], 2)
    assert (np.abs(found.boxes - boxes) <= 0.3 * sides + 1e-9).all()


def test_what_turns_out_to_be_one_vehicle_is_one_box(views: list[RenderedView]) -> None:
    view = views[0]
    rng = np.random.default_rng(2)
    true, first = shaken(view, rng)
    _, second = shaken(view, rng)
    both = Found(
        np.concatenate([first.boxes, second.boxes]),
        np.concatenate([np.full(len(true), 0.9), np.full(len(true), 0.5)]),
        np.zeros(2 * len(true), np.int64),
    )
    background = StillBackground(view.still, np.full(view.image.shape[:2], 255, np.uint8))
    found = EdgeRefiner().refine(view.image, background, both, nms_iou=0.6, classify=False)
    assert len(true) >= 2 and len(found.boxes) == len(true)
    assert (found.scores == 0.9).all() and (found.classes == 0).all()


def test_boxes_of_classes_that_it_does_not_know_stay_as_they_are(views: list[RenderedView]) -> None:
    view = views[0]
    true, _ = shaken(view, np.random.default_rng(0))
    boxes = np.stack([true[0], true[0]])
    classes = np.array([RoadUserClass.PEDESTRIAN.number, RoadUserClass.CAR.number])
    background = StillBackground(view.still, np.full(view.image.shape[:2], 255, np.uint8))
    found = EdgeRefiner().refine(
        view.image, background, Found(boxes, np.array([0.9, 0.8]), classes), nms_iou=0.6, classify=True
    )
    assert found.boxes[0].tolist() == boxes[0].tolist()
    assert found.classes[0] == RoadUserClass.PEDESTRIAN.number
    assert np.isnan(found.amodal_boxes[0]).all() and np.isnan(found.amodal_sd[0]).all()
    assert np.isfinite(found.amodal_boxes[1]).all()
