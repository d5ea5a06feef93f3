"""Pedestrians, cyclists and a motorcyclist from 2D boxes of four cameras to fits in the world."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from tests.builders import corner_rig
from tests.multiview import Scene, people, record
from wibam_core.association.associate import associate
from wibam_core.config import AssociateConfig, LiftConfig
from wibam_core.lifting.lift import lift
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import AnnotatedInstant


@lru_cache(maxsize=1)
def street() -> tuple[Scene, list[AnnotatedInstant]]:
    scene = record(corner_rig(), people(), duration_s=8.0, rate_hz=6.25, class_error=0.0, offset_ns=10_000_000)
    return scene, associate(scene.unassociated, scene.rig, AssociateConfig())


def test_views_of_one_person_are_put_together_and_followed() -> None:
    scene, found = street()
    tracks_of: dict[int, list[int]] = {}
    pairs = wrong = 0
    for instant, truth in zip(found, scene.instants, strict=True):
        own = {view: vehicle.track_id for vehicle in truth.vehicles for view in vehicle.views.items()}
        for vehicle in instant.vehicles:
            ids = [own.get(view) for view in vehicle.views.items()]
            pairs += len(ids) > 1
            wrong += len(set(ids)) > 1
            tracks_of.setdefault(vehicle.track_id, []).extend(i for i in ids if i is not None)
            known = {scene_class(scene, i) for i in ids if i is not None}
            assert not known or vehicle.vehicle_class in known
    assert pairs > 250
    assert wrong <= 0.01 * pairs
    long = [ids for ids in tracks_of.values() if len(ids) > 20]
    assert sorted(max(set(ids), key=ids.count) for ids in long) == list(range(6))  # one track each


def scene_class(scene: Scene, actor: int) -> RoadUserClass:
    return next(v.vehicle_class for instant in scene.instants for v in instant.vehicles if v.track_id == actor)


@pytest.mark.parametrize("road_user", [c for c in CLASSES if c.traits.vulnerable])
def test_people_are_fitted_where_they_are_and_as_large_as_they_are(road_user: RoadUserClass) -> None:
    scene, found = street()
    result = lift(found, scene.rig, LiftConfig())
    errors = []
    for fits, truth in zip(result.vehicles, scene.truth, strict=True):
        for row in np.flatnonzero(fits.classes == road_user.number):
            off = np.linalg.norm(truth.boxes[:, :2] - fits.boxes[row, :2], axis=1)
            nearest = int(off.argmin())
            assert truth.classes[nearest] == road_user.number
            turned = fits.boxes[row, 6] - truth.boxes[nearest, 6]
            moves = truth.ids[nearest] != 2
            errors.append(
                [
                    off[nearest],
                    *np.abs(np.log(fits.boxes[row, 3:6] / truth.boxes[nearest, 3:6])),
                    abs(np.arctan2(np.sin(turned), np.cos(turned))) if moves else np.nan,
                ]
            )
    assert len(errors) > 35
    place, length, _, height, yaw = np.nanmedian(errors, axis=0)
    assert place < 0.15
    assert length < 0.2 and height < 0.06
    assert yaw < np.radians(12)
