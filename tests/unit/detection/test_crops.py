"""Crops around boxes, and their pixels."""

import numpy as np
import pytest

from wibam_core.detection.crops import CROP_PX, Window, blob, crop, window


def test_pixels_and_shares_are_inverse():
    where = window(np.array([10.2, 20.7, 50.1, 44.4]))
    edges = np.array([0.2, 0.3, 0.7, 0.9])
    np.testing.assert_allclose(where.to_shares(where.to_px(edges)), edges)
    np.testing.assert_allclose(where.to_px(np.array([0.0, 0.0, 1.0, 1.0])), np.array(where) - 0.5)


def test_a_window_shows_the_box_and_a_quarter_of_it_on_each_side():
    box = np.array([100.0, 80.0, 140.0, 100.0])
    where = window(box)
    assert where.x0 <= 90 and where.x1 >= 150 and where.y0 <= 75 and where.y1 >= 105
    assert where.x1 - where.x0 <= 63 and where.y1 - where.y0 <= 33


@pytest.mark.parametrize("where", [Window(-8, -4, 20, 30), Window(40, 20, 90, 70), Window(-30, -30, 100, 100)])
def test_beyond_the_image_its_border_goes_on(where: Window):
    image = np.tile(np.arange(60, dtype=np.uint8)[None, :, None], (40, 1, 3))
    cut = crop(image, where)
    assert cut.shape == (CROP_PX, CROP_PX, 3)
    columns = np.clip(where.x0 + (np.arange(CROP_PX) + 0.5) * (where.x1 - where.x0) / CROP_PX - 0.5, 0, 59)
    np.testing.assert_allclose(cut[CROP_PX // 2, :, 0], columns, atol=1.5)


def test_the_channels_are_image_background_and_known():
    image, still = np.full((30, 40, 3), 51, np.uint8), np.full((30, 40, 3), 102, np.uint8)
    known = np.full((30, 40), 255, np.uint8)
    crops, windows = blob(image, np.dstack([still, known]), np.array([[5.0, 5.0, 20.0, 20.0]]))
    assert crops.shape == (1, 7, CROP_PX, CROP_PX) and len(windows) == 1
    np.testing.assert_allclose(crops[0].reshape(7, -1).mean(axis=1), [0.2] * 3 + [0.4] * 3 + [1.0], atol=1e-6)
