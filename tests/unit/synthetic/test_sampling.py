"""Views for training: repeatable, of the promised regimes, with usable truth."""

from __future__ import annotations

import numpy as np
import pytest

from wibam_core.synthetic.sampling import Regime, sample_views

HEIGHTS_M: dict[Regime, tuple[float, float]] = {"ego": (1.2, 3.0), "site": (5.0, 10.0), "elevated": (2.0, 14.0)}


@pytest.mark.parametrize("regime", HEIGHTS_M)
def test_views_are_consistent(regime: Regime) -> None:
    low, high = HEIGHTS_M[regime]
    vehicles = 0
    for view in sample_views(11, regime, 4, (256, 144)):
        assert view.image.shape == (144, 256, 3)
        assert view.image.dtype == np.uint8
        assert (view.camera.width_px, view.camera.height_px) == (256, 144)
        assert low <= view.camera.centre_m[2] <= high
        n = len(view.vehicles)
        assert view.visible_boxes.shape == view.amodal_boxes.shape == (n, 4)
        assert view.visibility.shape == (n,)
        assert (view.amodal_boxes[:, 2:] > view.amodal_boxes[:, :2]).all()
        vehicles += int((view.visibility > 0.3).sum())
    assert vehicles >= 4


@pytest.mark.parametrize("regime", HEIGHTS_M)
def test_the_same_seed_gives_the_same_views(regime: Regime) -> None:
    one, again = (list(sample_views(3, regime, 2, (128, 72))) for _ in range(2))
    other = list(sample_views(4, regime, 2, (128, 72)))
    for a, b in zip(one, again, strict=True):
        assert np.array_equal(a.image, b.image)
        assert np.array_equal(a.vehicles.boxes, b.vehicles.boxes)
        assert np.array_equal(a.visibility, b.visibility)
    assert not np.array_equal(one[0].image, other[0].image)


def test_a_view_does_not_depend_on_how_many_follow() -> None:
    few = list(sample_views(5, "ego", 2, (128, 72)))
    many = list(sample_views(5, "ego", 3, (128, 72)))
    assert all(np.array_equal(a.image, b.image) for a, b in zip(few, many, strict=False))


def test_ego_cameras_are_not_inside_vehicles() -> None:
    for view in sample_views(21, "ego", 6, (128, 72)):
        d = np.hypot(*(view.vehicles.boxes[:, :2] - view.camera.centre_m[:2]).T)
        assert (d > 1.2).all()


def test_headings_are_varied() -> None:
    yaws = [v.vehicles.boxes[:, 6] for seed in range(3) for v in sample_views(seed, "elevated", 2, (128, 72))]
    counts, _ = np.histogram(np.concatenate(yaws), bins=8, range=(-np.pi, np.pi))
    assert (counts > 0).sum() >= 6
