"""What a network does not know is not taught, and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.builders import site_of
from tests.site_dataset import give_tiny_site, tiny_rig, tiny_site
from wibam_core.artifacts import catalogue
from wibam_core.config import FinetuneConfig
from wibam_core.networks.registry import read_card, save_network
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.networks.small.network import CARD, SmallMonocular
from wibam_core.road_users import RoadUserClass
from wibam_core.stages import finetune
from wibam_core.training.dataset import site_views
from wibam_core.training.teachable import Teachable

CAR, VAN = RoadUserClass.CAR.number, RoadUserClass.VAN.number


def test_where_all_is_known_nothing_is_left_out(tmp_path: Path) -> None:
    site = tiny_site(tmp_path)
    taught = Teachable.of(site.instants, site.lifts, {RoadUserClass.CAR, RoadUserClass.VAN})
    assert taught.left_out == {}
    assert taught.cautions() == []
    before, after = (
        site_views(instants, site.frames, fits, site.rig)
        for instants, fits in ((site.instants, site.lifts), (taught.instants, taught.fits))
    )
    for one, two in zip(before, after, strict=True):
        for name, value in vars(one.pseudo_labels).items():
            if name != "camera":
                np.testing.assert_array_equal(value, getattr(two.pseudo_labels, name), err_msg=name)
        np.testing.assert_array_equal(one.other_boxes, two.other_boxes)


def test_boxes_fits_and_views_of_other_classes_go(tmp_path: Path) -> None:
    """The tiny site's second vehicle is a van; all cameras see both."""
    site = tiny_site(tmp_path)
    taught = Teachable.of(site.instants, site.lifts, {RoadUserClass.VAN})
    assert taught.left_out == {"car": len(site.rig) * len(site.instants)}
    views = site_views(taught.instants, site.frames, taught.fits, site.rig)
    for view in views:
        assert view.pseudo_labels.classes.tolist() == [VAN]
        assert view.other_vehicle.tolist() == [0] * (len(site.rig) - 1)
        assert len(view.pseudo_labels.ignored) == 0
    for instant in taught.instants:
        assert [vehicle.track_id for vehicle in instant.vehicles] == [8]
    assert all(fit.classes.tolist() == [VAN] for fit in taught.fits)


def test_a_box_goes_with_the_road_user_that_it_was_linked_to(tmp_path: Path) -> None:
    """One camera took the van for a car: its box is no car either."""
    site = tiny_site(tmp_path)
    for instant in site.instants:
        instant.detections["north"].classes[:] = CAR
    taught = Teachable.of(site.instants, site.lifts, {RoadUserClass.CAR})
    assert taught.left_out == {"car": len(site.instants), "van": 2 * len(site.instants)}
    for instant in taught.instants:
        assert all(len(seen) == 1 for seen in instant.detections.values())


def test_training_says_what_it_left_out(tmp_path: Path) -> None:
    """A network that knows cars alone, given as the site's own."""
    card = CARD.model_copy(update={"classes": ("car",)})
    save_network(SmallMonocular(SmallNetwork(mean_sizes_m=[(4.5, 1.8, 1.5)]), card), tmp_path / "cars.safetensors")
    folders = give_tiny_site(tmp_path / "site")
    context = folders.context("finetune", site_of(tiny_rig()), assets={"network": tmp_path / "cars.safetensors"})
    config = FinetuneConfig(network="custom", steps=1, batch_size=1, input_width_px=320)
    summary = finetune.run(context, config)
    assert summary["boxes_2d"] == 6  # one of two vehicles, by three cameras, at two instants
    (caution,) = (warning for warning in folders.warnings if warning.code == "classes_not_taught")
    assert caution.details == {"boxes_2d": {"van": 12}}
    assert read_card(folders.read(catalogue.WEIGHTS)).classes == ("car",)


def test_where_no_box_shows_anybody_on_foot_or_two_wheels_nobody_looked_for_them(tmp_path: Path) -> None:
    site = tiny_site(tmp_path)
    taught = Teachable.of(site.instants, site.lifts, set(RoadUserClass))
    people = {RoadUserClass.MOTORCYCLE, RoadUserClass.BICYCLE, RoadUserClass.PEDESTRIAN}
    assert taught.not_looked_for == people
    site.instants[0].detections["north"].classes[0] = RoadUserClass.PEDESTRIAN.number
    assert Teachable.of(site.instants, site.lifts, set(RoadUserClass)).not_looked_for == frozenset()
