"""Vehicles that were put together elsewhere get tracks, and stay what they are."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest

from tests.multiview import crossing
from wibam_core.association.linking import linked_over_time
from wibam_core.config import AssociateConfig
from wibam_core.errors import NoVehicles
from wibam_core.scene import AnnotatedInstant


@pytest.fixture(scope="module")
def given() -> list[AnnotatedInstant]:
    """The true vehicles of every instant, unlinked."""
    return [
        replace(instant, vehicles=tuple(replace(v, track_id=-1) for v in instant.vehicles))
        for instant in crossing().instants
    ]


@pytest.fixture(scope="module")
def linked(given: list[AnnotatedInstant]) -> list[AnnotatedInstant]:
    return linked_over_time(given, crossing().rig, AssociateConfig())


def test_which_boxes_are_one_vehicle_stays(given: list[AnnotatedInstant], linked: list[AnnotatedInstant]) -> None:
    for a, b in zip(given, linked, strict=True):
        assert [(v.obj_id, v.views, v.x_m, v.y_m) for v in a.vehicles] == [
            (v.obj_id, v.views, v.x_m, v.y_m) for v in b.vehicles
        ]


def test_tracks_follow_vehicles_and_have_one_class(linked: list[AnnotatedInstant]) -> None:
    actors: dict[int, Counter[int]] = {}
    classes: dict[int, set[str]] = {}
    for instant, truth in zip(linked, crossing().instants, strict=True):
        ids = [v.track_id for v in instant.vehicles if v.track_id >= 0]
        assert len(set(ids)) == len(ids)
        for vehicle, true in zip(instant.vehicles, truth.vehicles, strict=True):
            if vehicle.track_id >= 0:
                actors.setdefault(vehicle.track_id, Counter())[true.track_id] += 1
                classes.setdefault(vehicle.track_id, set()).add(vehicle.vehicle_class)
    total = sum(counter.total() for counter in actors.values())
    assert sum(counter.most_common(1)[0][1] for counter in actors.values()) / total > 0.97
    assert total / sum(len(i.vehicles) for i in linked) > 0.9
    assert all(len(found) == 1 for found in classes.values())


def test_without_boxes_there_is_nothing_to_link() -> None:
    with pytest.raises(NoVehicles):
        linked_over_time([AnnotatedInstant(0, {})], crossing().rig, AssociateConfig())
