"""Offsets that all edges of a detector's boxes share: told apart from sizes and bodies, and taken off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.unit.lifting.test_shapes import site
from wibam_core.lifting.edge_offsets import EdgeOffsets, learn_edge_offsets
from wibam_core.lifting.fit import FitProblem, fit
from wibam_core.lifting.shapes import MODES
from wibam_core.lifting.trajectory import Tracks
from wibam_core.road_users import RoadUserClass

OFFSETS = np.array([-0.4, 0.1, 0.4, 0.5])
NONE = np.zeros(len(MODES))


def seen_beside(p: FitProblem, offsets: np.ndarray) -> FitProblem:
    """The problem with all edges off by (4,) px."""
    return replace(p, boxes=p.boxes + torch.as_tensor(offsets, dtype=p.boxes.dtype))


def learned(p: FitProblem, classes: np.ndarray, tracks: Tracks) -> EdgeOffsets:
    return learn_edge_offsets(p, classes, tracks, np.ones(len(p), dtype=bool), iterations=50)


def place_error_m(p: FitProblem, truth: np.ndarray) -> float:
    found = fit(p, p.prior_mean[:, None], 50).parameters.numpy()
    return float(np.median(np.linalg.norm((found - truth)[:, :2], axis=1)))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_offsets_are_found_and_taken_off(sign: float) -> None:
    p, classes, tracks, truth = site(RoadUserClass.CAR, NONE, noise_px=0.3)
    shifted = seen_beside(p, sign * OFFSETS)
    found = learned(shifted, classes, tracks)
    assert found.tracks == 20
    assert np.abs(found.px - sign * OFFSETS).max() < 0.2
    assert (np.abs(found.px - sign * OFFSETS) < 3 * found.sd_px).all()
    np.testing.assert_allclose(found.taken_off(shifted).boxes, shifted.boxes - torch.as_tensor(found.px).float())
    assert place_error_m(found.taken_off(shifted), truth) < 1.2 * place_error_m(p, truth)


def test_boxes_without_an_offset_stay() -> None:
    p, classes, tracks, _ = site(RoadUserClass.CAR, NONE, noise_px=0.3)
    assert np.abs(learned(p, classes, tracks).px).max() < 0.15


def test_larger_vehicles_are_no_offset() -> None:
    """Sizes before looking are all too small: in the image, all boxes are larger than expected."""
    p, classes, tracks, _ = site(RoadUserClass.CAR, NONE, noise_px=0.3)
    p.prior_mean[:, 2:5] -= torch.tensor([0.08, 0.04, 0.06])
    assert np.abs(learned(p, classes, tracks).px).max() < 0.25


def test_another_body_is_no_offset() -> None:
    modes = np.array([0.05, -0.04, -0.05, 0.04, -0.05])
    p, classes, tracks, _ = site(RoadUserClass.CAR, modes, noise_px=0.3)
    assert np.abs(learned(p, classes, tracks).px).max() < 0.3


def test_few_tracks_and_unusable_ones_say_nothing() -> None:
    p, classes, tracks, _ = site(RoadUserClass.CAR, NONE, vehicles=5)
    found = learned(seen_beside(p, OFFSETS), classes, tracks)
    assert found.tracks == 0
    np.testing.assert_array_equal(found.px, np.zeros(4))
    p, classes, tracks, _ = site(RoadUserClass.CAR, NONE)
    nothing = learn_edge_offsets(p, classes, tracks, np.zeros(len(p), dtype=bool), iterations=50)
    assert nothing.tracks == 0


def test_an_offset_is_better_known_than_before_and_taken_only_where_boxes_fit_better_without_it() -> None:
    p, classes, tracks, _ = site(RoadUserClass.CAR, NONE, noise_px=0.3)
    before = EdgeOffsets.unknown()
    found = learned(seen_beside(p, OFFSETS), classes, tracks)
    assert (found.sd_px < before.sd_px).all()
    none = learned(p, classes, tracks)
    assert none.tracks == 0  # noise alone explains too little
    np.testing.assert_array_equal(none.px, np.zeros(4))
