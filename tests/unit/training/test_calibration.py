"""Factors of standard deviations, from fits instead of labels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.site_dataset import tiny_site
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.models.frames import Frame
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.networks.small.network import SmallMonocular
from wibam_core.scene import Vehicles3D
from wibam_core.training import calibration
from wibam_core.training.calibration import factors_from_fits, sd_factors
from wibam_core.training.dataset import SiteView, site_views
from wibam_core.training.finetune import SiteDataset


@pytest.fixture
def site(tmp_path: Path) -> SiteDataset:
    tiny = tiny_site(tmp_path)
    views = site_views(tiny.instants, tiny.frames, tiny.lifts, tiny.rig)
    return SiteDataset(tiny.frames, tiny.rig, [], 60 * views)


def predicted(view: SiteView, rng: np.random.Generator, factor: float) -> Vehicles3D:
    """The fits with Laplace errors that are ``factor`` times as large as they are said to be."""
    fits = view.pseudo_labels.boxes3d
    stated = np.tile([0.2, 0.2, 0.05, 0.2, 0.1, 0.1, 0.1], (len(fits), 1))
    return Vehicles3D.of(view.time_ns, fits + rng.laplace(0, factor * stated / np.sqrt(2)), sd=stated)


@pytest.mark.parametrize("factor", [0.6, 1.7])
def test_errors_against_the_fits_give_the_factor(site: SiteDataset, factor: float) -> None:
    rng = np.random.default_rng(0)
    views = site.validation
    found = factors_from_fits([predicted(view, rng, factor) for view in views], views)
    for name, got in vars(found).items():
        never_surer = name in ("z", "size")
        assert got == pytest.approx(max(factor, 1.0) if never_surer else factor, rel=0.2), name


def test_a_fit_that_does_not_know_the_front_says_nothing_of_the_heading(site: SiteDataset) -> None:
    rng = np.random.default_rng(0)
    found = []
    for view in site.validation:
        vehicles = predicted(view, rng, 1.0)
        vehicles.boxes[~view.pseudo_labels.front_known, 6] += np.pi
        found.append(vehicles)
    assert factors_from_fits(found, site.validation).yaw == pytest.approx(1, rel=0.3)


def test_what_is_no_vehicle_of_the_fits_says_nothing(site: SiteDataset) -> None:
    away = np.array([[40.0, 40, 0.75, 4, 2, 1.5, 0]])
    found = [Vehicles3D.of(view.time_ns, away, sd=np.full((1, 7), 0.1)) for view in site.validation]
    assert factors_from_fits(found, site.validation) == SdFactors()


def parts_of(folder: Path) -> SiteDataset:
    """Different instants to train and to validate on."""
    tiny = tiny_site(folder)
    views = site_views(tiny.instants, tiny.frames, tiny.lifts, tiny.rig)
    middle = tiny.instants[2].time_ns
    train, validation = ([v for v in views if (v.time_ns < middle) == early] for early in (True, False))
    assert train and validation
    return SiteDataset(tiny.frames, tiny.rig, 60 * train, 60 * validation)


def test_a_network_is_judged_by_the_validation_part_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site, rng = parts_of(tmp_path), np.random.default_rng(0)
    #: Errors are by so much larger than they are said to be.
    factor_of = {(view.camera_id, view.time_ns): (view, 0.5) for view in site.train}
    factor_of |= {(view.camera_id, view.time_ns): (view, 2.0) for view in site.validation}
    network, asked = SmallMonocular(SmallNetwork()), []

    def oracle(given: object, frames: Iterable[Frame], *, decode: str, min_score: float) -> Iterator[Vehicles3D]:
        assert given is network and decode == "fused" and min_score < 0.5
        for frame in frames:
            view, factor = factor_of[frame.camera_id, frame.time_ns]
            np.testing.assert_array_equal(frame.image, site.frames.image(view.camera_id, view.time_ns))
            assert frame.camera is site.rig[view.camera_id]
            asked.append(frame.time_ns)
            yield predicted(view, rng, factor)

    monkeypatch.setattr(calibration, "predict", oracle)
    found = sd_factors(network, site, "fused")
    assert set(asked) == {view.time_ns for view in site.validation}
    for name, got in vars(found).items():
        assert 1.4 < got < 2.4, name  # 0.5, or 1 for those that are never surer, of the training part


def test_a_network_that_finds_nothing_or_has_nothing_to_look_at_is_taken_at_its_word(site: SiteDataset) -> None:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    alone = SiteDataset(site.frames, site.rig, [], site.validation[:2])
    untrained = SmallMonocular(SmallNetwork())  # it finds nothing
    assert sd_factors(untrained, alone, "plane") == SdFactors()
    assert sd_factors(untrained, SiteDataset(site.frames, site.rig, [], []), "plane") == SdFactors()
