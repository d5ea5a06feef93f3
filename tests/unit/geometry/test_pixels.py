from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import look_at
from wibam_core.geometry.pixels import (
    resized_height_px,
    resized_image,
    resized_px,
    scale_of,
    shrunk_image,
)

sides = st.integers(1, 5000)


def test_convention_resizing_keeps_pixel_areas() -> None:
    """Four pixels become one, whose centre is the middle of theirs; borders stay borders."""
    quarter = scale_of((640, 360), (160, 90), 4)
    assert resized_px(np.array([-0.5, -0.5, 639.5, 359.5]), quarter).tolist() == [-0.5, -0.5, 159.5, 89.5]
    assert resized_px(np.array([1.5, 5.5]), scale_of((640, 360), (160, 90))).tolist() == [0.0, 1.0]


@given(sides, sides, sides, sides)
def test_law_resizing_back_leads_back(width: int, height: int, new_width: int, new_height: int) -> None:
    boxes = np.random.default_rng(0).uniform(-0.5, 5000, (8, 4))
    there = scale_of((width, height), (new_width, new_height), 4)
    np.testing.assert_allclose(resized_px(resized_px(boxes, there), 1 / there), boxes, rtol=1e-9, atol=1e-9)


def test_tensors_move_as_arrays_do() -> None:
    points = np.random.default_rng(0).uniform(0, 500, (7, 2))
    moved = resized_px(torch.from_numpy(points), torch.tensor([0.3, 1.7], dtype=torch.float64))
    assert np.array_equal(moved.numpy(), resized_px(points, np.array([0.3, 1.7])))


def test_a_resized_camera_sees_a_point_where_the_resized_image_shows_it() -> None:
    camera = look_at((10, -7, 6))
    small = camera.resized(320, 180)
    point = np.array([1.0, 2.0, 0.5])
    u, v = camera.project(point)[0]
    assert small.size_px == (320, 180)
    np.testing.assert_allclose(small.project(point)[0], [(u + 0.5) / 2 - 0.5, (v + 0.5) / 2 - 0.5])


def test_a_shrunk_image_shows_things_where_their_pixels_go() -> None:
    image = np.zeros((90, 160, 3), np.uint8)
    image[40:48, 100:108] = 255
    small = shrunk_image(image, 40)
    rows, columns = np.nonzero(small[..., 0] > 127)
    assert small.shape == (22, 40, 3)
    assert columns.mean() == pytest.approx((103.5 + 0.5) / 4 - 0.5, abs=0.01)
    assert rows.mean() == pytest.approx((43.5 + 0.5) * 22 / 90 - 0.5, abs=0.3)
    assert shrunk_image(image, 160) is image


def test_an_image_shrinks_by_area_and_grows_smoothly() -> None:
    stripes = np.tile(np.array([0, 200], np.uint8), (4, 8))[..., None].repeat(3, axis=2)
    assert (resized_image(stripes, 8, 4) == 100).all(), "each pixel is the mean of the two that it replaces"
    wide = resized_image(stripes[:, :2], 4, 4)
    assert wide[0, :, 0].tolist() == [0, 50, 150, 200]


def test_heights_keep_the_aspect_ratio_and_never_vanish() -> None:
    assert resized_height_px(1920, 1080, 640) == 360
    assert resized_height_px(4000, 2, 100) == 1
