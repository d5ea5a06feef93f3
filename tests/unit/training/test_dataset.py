"""Labels of site frames: in the right pixels, at the right moment, of the right vehicle."""

from pathlib import Path

import numpy as np
import pytest

from tests.site_dataset import LATENESS_NS, PERIOD_NS, TinySite, boxes_at, tiny_site, without_detection
from wibam_core.geometry.box3d import corners
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.models.frames import INPUT_WIDTH_PX, prepare_image
from wibam_core.models.trunk import INPUT_MULTIPLE
from wibam_core.training.dataset import ImageCache, input_width_of, site_views


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> TinySite:
    return tiny_site(tmp_path_factory.mktemp("site"))


def test_3d_labels_project_into_the_2d_boxes_of_the_moment_of_exposure(site: TinySite) -> None:
    views = site_views(site.instants, site.frames, site.lifts, site.rig)
    assert len(views) == 12
    for view in views:
        uv, _ = view.pseudo_labels.camera.project(corners(view.pseudo_labels.boxes3d))
        tight = np.concatenate([uv.min(axis=1), uv.max(axis=1)], axis=1)
        np.testing.assert_allclose(view.pseudo_labels.boxes2d, tight, atol=1e-6)
        when = view.time_ns + LATENESS_NS[view.camera_id]
        np.testing.assert_allclose(view.pseudo_labels.boxes3d, boxes_at(when), atol=1e-9)


def test_labels_are_as_wide_as_the_network_sees_the_images(site: TinySite, tmp_path: Path) -> None:
    usual, wide = (site_views(site.instants, site.frames, site.lifts, site.rig, input_width_px=w) for w in (640, 960))
    assert input_width_of(wide) == 960 and input_width_of([]) == INPUT_WIDTH_PX
    for small, large in zip(usual, wide, strict=True):
        np.testing.assert_allclose(large.pseudo_labels.boxes2d + 0.5, (small.pseudo_labels.boxes2d + 0.5) * 1.5)
        np.testing.assert_allclose(large.other_boxes + 0.5, (small.other_boxes + 0.5) * 1.5)
        np.testing.assert_array_equal(large.pseudo_labels.boxes3d, small.pseudo_labels.boxes3d)
    image = ImageCache(tmp_path / "images.npy", wide, site.frames).view(3).image
    assert image.shape == (256, 960, 3)
    prepared = prepare_image(site.frames.image(wide[3].camera_id, wide[3].time_ns), 960)
    np.testing.assert_array_equal(image[: len(prepared)], prepared)


def test_confidence_and_unknown_fronts_come_from_the_fits(site: TinySite) -> None:
    labels = site_views(site.instants, site.frames, site.lifts, site.rig)[0].pseudo_labels
    np.testing.assert_array_equal(labels.confidence, [1.0, 0.5])
    np.testing.assert_array_equal(labels.front_known, [True, False])


def test_other_views_are_those_of_the_same_vehicle(site: TinySite) -> None:
    view = site_views(site.instants, site.frames, site.lifts, site.rig)[1]  # east at the first instant
    assert view.camera_id == "east"
    assert sorted(zip(view.other_vehicle.tolist(), view.other_camera.tolist(), strict=True)) == [
        (0, 0), (0, 2), (1, 0), (1, 2),
    ]  # fmt: skip
    names = list(site.rig)
    for vehicle, camera, box in zip(view.other_vehicle, view.other_camera, view.other_boxes, strict=True):
        native = site.instants[0].detections[names[camera]].boxes[vehicle]
        np.testing.assert_allclose(box, (native + 0.5) * (INPUT_WIDTH_PX / 640) - 0.5)


def test_vehicles_of_another_subset_are_ignored_and_those_not_fitted_keep_their_2d_boxes(site: TinySite) -> None:
    without = [vehicles.where(np.array([True, False])) for vehicles in site.lifts]
    whole = site_views(site.instants, site.frames, site.lifts, site.rig)[0]
    view = site_views(site.instants, site.frames, without, site.rig, frozenset({7}))[0]
    np.testing.assert_allclose(view.pseudo_labels.ignored, whole.pseudo_labels.boxes2d[:1])
    np.testing.assert_allclose(view.pseudo_labels.boxes2d, whole.pseudo_labels.boxes2d[1:])
    assert view.pseudo_labels.classes.tolist() == [1]
    assert np.isnan(view.pseudo_labels.boxes3d).all()
    assert view.other_vehicle.tolist() == [0, 0]
    np.testing.assert_allclose(view.other_boxes, whole.other_boxes[whole.other_vehicle == 1])


def test_what_one_camera_overlooked_is_labelled_by_the_fits(site: TinySite) -> None:
    instants = [without_detection(instant, "east", 0) for instant in site.instants]
    whole = site_views(site.instants, site.frames, site.lifts, site.rig)
    for before, view in zip(whole, site_views(instants, site.frames, site.lifts, site.rig), strict=True):
        order = [1, 0] if view.camera_id == "east" else [0, 1]  # it comes after what was found
        np.testing.assert_allclose(view.pseudo_labels.boxes3d, before.pseudo_labels.boxes3d[order], atol=1e-9)
        np.testing.assert_array_equal(view.pseudo_labels.classes, before.pseudo_labels.classes[order])
        np.testing.assert_array_equal(view.pseudo_labels.confidence, before.pseudo_labels.confidence[order])
        np.testing.assert_array_equal(view.pseudo_labels.front_known, before.pseudo_labels.front_known[order])
        assert image_iou(view.pseudo_labels.boxes2d, before.pseudo_labels.boxes2d[order]).diagonal().min() > 0.7
        assert len(view.pseudo_labels.ignored) == 0
        if view.camera_id == "east":
            assert set(view.other_vehicle.tolist()) == {0}  # the published loss knows vehicles by detections alone


def test_what_was_overlooked_of_another_subset_is_not_judged(site: TinySite) -> None:
    instants = [without_detection(instant, "east", 0) for instant in site.instants]
    found = site_views(instants, site.frames, site.lifts, site.rig)[1]
    view = site_views(instants, site.frames, site.lifts, site.rig, frozenset({7}))[1]
    assert view.pseudo_labels.classes.tolist() == [1]
    np.testing.assert_allclose(view.pseudo_labels.ignored, found.pseudo_labels.boxes2d[1:])
    alone = site_views(instants, site.frames, site.lifts, site.rig, frozenset({7}), complete=False)[1]
    assert len(alone.pseudo_labels.classes) == 1 and len(alone.pseudo_labels.ignored) == 0


def test_one_instant_alone_has_no_velocity(site: TinySite) -> None:
    views = site_views(site.instants[:1], site.frames, site.lifts[:1], site.rig)
    for view in views:
        np.testing.assert_allclose(view.pseudo_labels.boxes3d, boxes_at(0))


def test_images_are_prepared_once_and_padded(site: TinySite, tmp_path: Path) -> None:
    views = site_views(site.instants, site.frames, site.lifts, site.rig)
    cache = ImageCache(tmp_path / "images.npy", views, site.frames)
    first = cache.view(5)
    height = INPUT_WIDTH_PX // 4  # the cameras' shape
    assert first.image.shape == (height + -height % INPUT_MULTIPLE, INPUT_WIDTH_PX, 3)
    for number, view in enumerate(views):
        prepared = prepare_image(site.frames.image(view.camera_id, view.time_ns))
        for _ in range(2):  # decoded, then read back
            np.testing.assert_array_equal(cache.view(number).image[: len(prepared)], prepared)
    box = np.rint(first.boxes2d[0]).astype(int)
    middle = first.image[(box[1] + box[3]) // 2, (box[0] + box[2]) // 2]
    assert middle[2] > 150  # vehicles are painted red
    assert views[5].time_ns == PERIOD_NS
