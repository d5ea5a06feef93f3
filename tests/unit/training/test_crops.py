"""Windows of images: what is in them is where their camera says, and every vehicle is taught in some of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.builders import look_at
from tests.site_dataset import tiny_site
from wibam_core.config import FinetuneConfig
from wibam_core.training.batches import Batches
from wibam_core.training.crops import Window, crop, crop_camera, windows
from wibam_core.training.dataset import ImageCache, SiteView, site_views
from wibam_core.training.multiview import OtherCameras
from wibam_core.training.views import LabelledView

WIDTH, HEIGHT = 640, 384


def view_with(boxes: list[tuple[float, float, float, float]], **values: object) -> LabelledView:
    """A view of 640 x 360 px and rows of padding, each pixel of which says where it is; vehicle k is k m long."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    n = len(boxes)
    view = LabelledView(
        image=np.stack([columns % 256, columns // 256, rows // 2], axis=-1).astype(np.uint8),
        camera=look_at((0.0, 20.0, 6.0), focal_px=420.0, width_px=WIDTH, height_px=360),
        boxes2d=np.array(boxes, np.float64).reshape(-1, 4),
        classes=np.zeros(n, np.int64),
        boxes3d=np.column_stack([np.zeros((n, 3)), np.arange(n), np.ones((n, 2)), np.zeros(n)]),
        confidence=np.linspace(0.1, 1.0, n),
        front_known=np.ones(n, bool),
        ignored=np.array([[10.0, 10.0, 20.0, 20.0], [600.0, 300.0, 630.0, 340.0]]),
    )
    return replace(view, **values)


@pytest.mark.parametrize("dist", [(), (-0.15, 0.02, 0.001, -0.001, 0.0)])
def test_a_windows_camera_sees_what_the_whole_one_sees_less_its_corner(dist: tuple[float, ...]) -> None:
    camera = look_at((0.0, 20.0, 6.0), focal_px=420.0, width_px=WIDTH, height_px=360, dist=dist)
    part = crop_camera(camera, Window(192, 130, 256, 160))
    points = np.random.default_rng(0).uniform([-15, -15, 0], [15, 15, 3], (500, 3))
    whole, depth = camera.project(points)
    inside = ((whole >= [192, 130]) & (whole <= [192 + 255, 130 + 159])).all(axis=1)
    assert inside.sum() > 20
    uv, its_depth = part.project(points[inside])
    np.testing.assert_allclose(uv, whole[inside] - [192, 130], atol=1e-9)
    np.testing.assert_allclose(its_depth, depth[inside])
    assert part.size_px == (256, 160)
    assert crop_camera(camera, Window(0, 224, 256, 160)).size_px == (256, 136)  # 24 rows below are padding


def test_vehicles_that_a_window_cuts_are_ignored_and_the_others_moved() -> None:
    boxes = [(200.0, 150.0, 260.0, 190.0), (400.0, 150.0, 500.0, 190.0), (10.0, 10.0, 40.0, 30.0)]
    part, kept = crop(view_with(boxes), Window(192, 130, 256, 160))
    assert kept.tolist() == [0]
    assert part.boxes2d.tolist() == [[8.0, 20.0, 68.0, 60.0]]
    assert part.boxes3d[:, 3].tolist() == [0.0]
    assert part.ignored.shape == (1, 4)  # what is cut; the regions of the whole view lie outside
    np.testing.assert_allclose(part.ignored[0], [208.0, 20.0, 256.0, 60.0], atol=0.5)
    assert part.image.shape == (160, 256, 3)
    assert part.image[0, 0].tolist() == [192, 0, 65]
    assert part.whole_width_px == WIDTH
    assert crop(part, Window(0, 0, 64, 64))[0].whole_width_px == WIDTH


def test_windows_lie_in_the_image_and_hold_every_vehicle_sooner_or_later() -> None:
    corner = (0.0, 0.0, 50.0, 30.0)
    large = (100.0, 50.0, 450.0, 300.0)  # larger than 0.4 of the image
    views = [view_with([corner, (560.0, 320.0, 639.0, 359.0)]), view_with([large, corner]), view_with([])]
    rng, taught, sizes, empty = np.random.default_rng(0), [set[int](), set[int]()], set(), set()
    for _ in range(200):
        batch = windows(views, 0.4, rng)
        assert len({(one.width_px, one.height_px) for one in batch}) == 1
        sizes.add((batch[0].width_px, batch[0].height_px))
        for one in batch:
            assert min(one.left_px, one.top_px) >= 0
            assert one.left_px + one.width_px <= WIDTH
            assert one.top_px + one.height_px <= HEIGHT
        for rows, view, one in zip(taught, views, batch, strict=False):
            rows |= set(crop(view, one)[1].tolist())
        empty.add((batch[2].left_px, batch[2].top_px))
    assert taught == [{0, 1}, {0, 1}]
    assert sizes == {(256, 160), (352, 256)}  # multiples of 32: 0.4 of the image, and the large vehicle's
    assert len(empty) > 100


def test_the_window_that_teaches_most_is_preferred() -> None:
    crowd = [(400.0 + 30 * k, 200.0, 420.0 + 30 * k, 215.0) for k in range(5)]
    views = [view_with([(10.0, 10.0, 30.0, 25.0), *crowd])]
    rng = np.random.default_rng(0)
    held = [len(crop(views[0], windows(views, 0.4, rng)[0])[1]) for _ in range(200)]
    assert np.mean(held) > 3.0  # one vehicle in six stands alone, and windows about the crowd may cut it


def test_a_whole_window_changes_nothing() -> None:
    view = view_with([(200.0, 150.0, 260.0, 190.0), (600.0, 150.0, 700.0, 190.0)])  # the border cuts one
    (window,) = windows([view], 1.0, np.random.default_rng(0))
    part, kept = crop(view, window)
    assert kept.tolist() == [0, 1]
    assert np.array_equal(part.image, view.image)
    assert part.camera.size_px == view.camera.size_px
    assert np.array_equal(part.camera.K, view.camera.K)
    assert np.array_equal(part.boxes2d, view.boxes2d)
    np.testing.assert_allclose(part.ignored, view.ignored)


@pytest.fixture
def batches(tmp_path: Path) -> tuple[Batches, list[SiteView], OtherCameras]:
    site = tiny_site(tmp_path / "frames")
    views = site_views(site.instants, site.frames, site.lifts, site.rig)
    cache = ImageCache(tmp_path / "cache.npy", views, site.frames)
    config = FinetuneConfig(method="paper", batch_size=4, crop_share=0.4)
    return Batches(views, cache.view, config), views, OtherCameras(site.rig)


def test_a_step_always_draws_the_same(batches: tuple[Batches, list[SiteView], OtherCameras]) -> None:
    drawn, _, _ = batches
    one, two, other = drawn.to_learn(3), drawn.to_learn(3), drawn.to_learn(4)
    for a, b in zip(one.views, two.views, strict=True):
        assert np.array_equal(a.image, b.image)
        assert np.array_equal(a.boxes2d, b.boxes2d)
    assert any(not np.array_equal(a.image, b.image) for a, b in zip(one.views, other.views, strict=True))
    judged = drawn.to_judge(0, 4), drawn.to_judge(0, 4)
    assert all(np.array_equal(a.image, b.image) for a, b in zip(judged[0].views, judged[1].views, strict=True))


def test_other_views_stay_with_the_vehicles_of_a_window(
    batches: tuple[Batches, list[SiteView], OtherCameras],
) -> None:
    """A pair must name the box that the other camera has of the very vehicle, whatever the windows leave out."""
    drawn, views, others = batches
    pairs = 0
    for step in range(20):
        batch, numbers = drawn.to_learn(step), drawn.numbers(step)
        sizes = np.concatenate([view.boxes3d[:, 3] for view in batch.views])
        of_batch = others.of(batch.sources, [False] * len(batch.sources))
        given = {
            (size, tuple(box))
            for number in numbers
            for size, box in zip(
                views[number].pseudo_labels.boxes3d[views[number].other_vehicle, 3],
                views[number].other_boxes,
                strict=True,
            )
        }
        for vehicle, box in zip(of_batch.vehicle.tolist(), of_batch.boxes.numpy(), strict=True):
            assert (sizes[vehicle], tuple(box)) in given
            pairs += 1
    assert pairs > 20
