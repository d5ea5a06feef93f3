"""When a site has shown too few vehicles, and how much longer it should be recorded."""

from pathlib import Path

import numpy as np
import pytest

from tests.site_dataset import tiny_site
from wibam_core.dataset.sufficiency import (
    MIN_VEHICLES,
    footage_s,
    paired_vehicles,
    sufficiency,
    taught_vehicles,
    training_sufficiency,
)
from wibam_core.documents.split import Split
from wibam_core.errors import NoMultiViewVehicles


@pytest.mark.parametrize(
    ("vehicles", "seconds", "more"),
    [
        (MIN_VEHICLES, 60.0, 0),
        (500, 60.0, 0),
        (15, 120.0, 2),  # as many again in as long again
        (10, 600.0, 20),
        (29, 600.0, 1),  # rounded up
        (1, 60.0, 29),
        (0, 60.0, 29),  # one is taken to be about to come
    ],
)
def test_more_minutes_at_the_observed_rate(vehicles: int, seconds: float, more: int) -> None:
    found = sufficiency(vehicles, seconds)
    assert found.more_minutes == more
    assert (not found.cautions) == (more == 0)
    if more and vehicles:
        found.require_any()
        [caution] = found.cautions
        assert f"{vehicles} vehicle" in caution.message
        assert f"{more} minute{'s' if more > 1 else ''} more" in caution.hint


def test_no_vehicle_at_all_says_how_much_longer_to_record() -> None:
    with pytest.raises(NoMultiViewVehicles, match="2 minutes of footage gave no vehicle") as caught:
        sufficiency(0, 90.0).require_any()
    assert "44 minutes more" in caught.value.hint
    assert "calibration" in caught.value.hint
    assert caught.value.details == {"more_minutes": 44}


def test_vehicles_are_counted_once_and_only_in_the_training_part(tmp_path: Path) -> None:
    site = tiny_site(tmp_path)
    times = tuple(instant.time_ns for instant in site.instants)

    def split(left_out: frozenset[int], train: tuple[int, ...] = times[:2]) -> Split:
        nobody: frozenset[int] = frozenset()
        return Split(
            times_ns={"train": train, "val": times[2:3], "test": times[3:]},
            left_out_tracks={"train": left_out, "val": nobody, "test": nobody},
        )

    nobody = split(frozenset())
    for method in ("lifted", "paper", "combined"):
        found = training_sufficiency(method, site.instants, site.lifts, nobody)
        assert (found.vehicles, found.footage_s) == (2, pytest.approx(1.2))
    assert training_sufficiency("paper", site.instants, [], nobody).vehicles == 2
    assert training_sufficiency("combined", site.instants, [], nobody).vehicles == 0
    assert taught_vehicles(site.lifts, nobody) == paired_vehicles(site.instants, nobody) == 2
    without = split(frozenset({8}))
    assert taught_vehicles(site.lifts, without) == paired_vehicles(site.instants, without) == 1
    assert taught_vehicles(site.lifts, split(frozenset(), ())) == 0
    one = [vehicles.where(np.array([True, False])) for vehicles in site.lifts]
    assert taught_vehicles(one, nobody) == 1
    assert footage_s(site.instants) == pytest.approx(1.2)
    assert footage_s([]) == 0.0
