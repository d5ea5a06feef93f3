"""Augmented images, cameras and labels stay consistent: what is where in the image is where the camera says."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.labelled_views import VEHICLES, camera, tight_boxes, view_of
from wibam_core.geometry.box3d import corners
from wibam_core.geometry.camera import Camera
from wibam_core.training.augment import (
    compress,
    cut_out,
    jitter_colour,
    mirror,
    mirror_boxes3d,
    mirror_camera,
    rewarp,
    shake,
    turn_camera,
)


@pytest.mark.parametrize("dist", [(), (-0.2, 0.05, 0.003, -0.004, 0.01)])
def test_convention_mirrored_camera_sees_mirrored_world_in_mirrored_columns(dist: tuple[float, ...]) -> None:
    cam = camera(dist)
    points = corners(VEHICLES)
    before, _ = cam.project(points)
    after, _ = mirror_camera(cam).project(points * [1, -1, 1])
    np.testing.assert_allclose(after[..., 0], 511 - before[..., 0], atol=1e-9)
    np.testing.assert_allclose(after[..., 1], before[..., 1], atol=1e-9)


def test_mirrored_boxes_have_the_mirrored_corners() -> None:
    mirrored = corners(mirror_boxes3d(VEHICLES)) * [1, -1, 1]
    for ours, theirs in zip(mirrored, corners(VEHICLES), strict=True):
        gaps = np.linalg.norm(ours[:, None] - theirs[None], axis=2).min(axis=1)
        assert gaps.max() < 1e-12


def test_mirroring_twice_changes_nothing() -> None:
    view = view_of(VEHICLES, camera((-0.1, 0.01, 0.001, 0.002)))
    again = mirror(mirror(view))
    np.testing.assert_allclose(again.boxes2d, view.boxes2d, atol=1e-9)
    np.testing.assert_allclose(again.boxes3d, view.boxes3d, atol=1e-12)
    np.testing.assert_allclose(again.camera.T_world_cam.matrix, view.camera.T_world_cam.matrix, atol=1e-12)
    np.testing.assert_array_equal(again.image, view.image)


@settings(max_examples=25)
@given(
    down=st.floats(-0.1, 0.3),
    left=st.floats(-0.15, 0.15),
    roll=st.floats(-0.05, 0.05),
    zoom=st.floats(0.7, 1.5),
)
def test_rewarped_image_matches_its_camera(down: float, left: float, roll: float, zoom: float) -> None:
    cam = camera()
    view = view_of(VEHICLES, cam)
    x, y = np.rint(cam.project(np.array([14.0, 0.4, 0.5]))[0]).astype(int)
    bright = cam.centre_m + 10.0 * cam.rays(np.array([x, y], dtype=float))  # on the ray of the very pixel
    view.image[y - 3 : y + 4, x - 3 : x + 4] = 255
    K = np.array([[420 * zoom, 0, 255.5], [0, 420 * zoom, 143.5], [0, 0, 1]])
    target = Camera(K, np.zeros(0), turn_camera(cam, down, left, roll), 512, 288)
    warped = rewarp(view, target, (0, 0, 0))
    expected, _ = target.project(bright)
    if not (10 < expected[0] < 500 and 10 < expected[1] < 277):
        return
    rows, columns = np.nonzero(warped.image[..., 0] > 200)
    assert abs(columns.mean() - expected[0]) < 0.6
    assert abs(rows.mean() - expected[1]) < 0.6


def test_rewarped_boxes_hold_their_vehicles_and_ignore_cut_ones() -> None:
    cam = camera()
    view = view_of(VEHICLES, cam)
    turned = Camera(cam.K, cam.dist, turn_camera(cam, 0.12, 0.0, 0.0), 512, 288)
    warped = rewarp(view, turned, (0, 0, 0))
    assert len(warped.classes) == 2
    tight = tight_boxes(VEHICLES, turned)
    np.testing.assert_allclose(warped.boxes2d, tight, atol=4.0)
    assert (warped.boxes2d[:, :2] <= tight[:, :2] + 1e-6).all()
    away = Camera(cam.K, cam.dist, turn_camera(cam, -0.33, 0.0, 0.0), 512, 288)
    cut = rewarp(view, away, (0, 0, 0))
    assert len(cut.classes) + len(cut.ignored) <= 2
    assert len(cut.classes) < 2


def test_pitching_down_moves_the_horizon_up() -> None:
    cam = camera()
    turned = Camera(cam.K, cam.dist, turn_camera(cam, 0.2, 0.0, 0.0), 512, 288)
    far = np.array([1000.0, -2.0, 1.6])
    assert turned.project(far)[0][1] < cam.project(far)[0][1] - 50
    left = Camera(cam.K, cam.dist, turn_camera(cam, 0.0, 0.2, 0.0), 512, 288)
    assert left.project(far)[0][0] > cam.project(far)[0][0] + 50


def test_image_augmentations_keep_shape_and_are_seeded() -> None:
    image = np.random.default_rng(0).integers(0, 256, (64, 96, 3), dtype=np.uint8)
    for augment in (jitter_colour, compress, cut_out):
        results = [augment(image, np.random.default_rng(seed)) for seed in (3, 3, 4)]
        assert results[0].shape == image.shape
        assert results[0].dtype == np.uint8
        np.testing.assert_array_equal(results[0], results[1])


def test_shaken_views_keep_labels_where_the_vehicles_are() -> None:
    view = view_of(VEHICLES, camera())
    padded = replace(view, image=np.pad(view.image, ((0, 32), (0, 0), (0, 0))))
    kept = 0
    for seed in range(10):
        shaken = shake(padded, np.random.default_rng(seed))
        assert shaken.image.shape == padded.image.shape
        assert (shaken.image[288:] == 0).all()
        np.testing.assert_allclose(shaken.camera.centre_m, view.camera.centre_m)
        inside = np.clip(tight_boxes(shaken.boxes3d, shaken.camera), -0.5, [511.5, 287.5, 511.5, 287.5])
        np.testing.assert_allclose(shaken.boxes2d, inside, atol=6.0)
        kept += len(shaken.classes)
    assert kept >= 10


def test_views_with_distortion_are_not_shaken() -> None:
    view = view_of(VEHICLES, camera((-0.2, 0.05, 0.0, 0.0)))
    assert shake(view, np.random.default_rng(0)) is view
