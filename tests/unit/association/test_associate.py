from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import pytest

from tests.builders import corner_rig, look_at
from tests.multiview import crossing
from wibam_core.association.associate import associate, association_statistics
from wibam_core.config import AssociateConfig
from wibam_core.errors import NoMultiViewVehicles, NoVehicles
from wibam_core.geometry.projection import project_boxes
from wibam_core.geometry.se3 import SE3
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, MultiViewVehicle

CONFIG = AssociateConfig()


def pairs(vehicles: tuple[MultiViewVehicle, ...]) -> set[frozenset[tuple[str, int]]]:
    return {frozenset(pair) for vehicle in vehicles for pair in combinations(vehicle.views.items(), 2)}


def no_boxes(camera_id: str) -> Detections2D:
    return Detections2D(camera_id, 0, np.empty((0, 4)), np.empty(0), np.empty(0, np.int64))


def test_pairs_of_boxes_are_right() -> None:
    scene = crossing()
    found = associate(scene.unassociated, scene.rig, CONFIG)
    true = [pairs(i.vehicles) for i in scene.instants]
    mine = [pairs(i.vehicles) for i in found]
    right = sum(len(a & b) for a, b in zip(true, mine, strict=True))
    assert right / sum(map(len, mine)) > 0.985
    assert right / sum(map(len, true)) > 0.97


def test_tracks_follow_vehicles() -> None:
    scene = crossing()
    owner = [{view: v.track_id for v in i.vehicles for view in v.views.items()} for i in scene.instants]
    of_track: dict[int, list[int]] = {}
    for instant, own in zip(associate(scene.unassociated, scene.rig, CONFIG), owner, strict=True):
        for vehicle in instant.vehicles:
            actors = [own[view] for view in vehicle.views.items() if view in own]
            if vehicle.track_id >= 0 and len(vehicle.views) > 1 and actors:
                of_track.setdefault(vehicle.track_id, []).append(max(actors, key=actors.count))
    pure = sum(max(actors.count(a) for a in set(actors)) for actors in of_track.values())
    assert pure / sum(map(len, of_track.values())) > 0.97
    actors_seen = {a for actors in of_track.values() for a in actors}
    assert len(of_track) < 3 * len(actors_seen)


def test_a_track_has_one_class() -> None:
    scene = crossing()
    classes: dict[int, set[str]] = {}
    for instant in associate(scene.unassociated, scene.rig, CONFIG):
        for vehicle in instant.vehicles:
            if vehicle.track_id >= 0:
                classes.setdefault(vehicle.track_id, set()).add(vehicle.vehicle_class)
    assert all(len(c) == 1 for c in classes.values())


def test_every_box_in_range_belongs_to_exactly_one_vehicle_and_nothing_else_changes() -> None:
    scene = crossing()
    for before, after in zip(scene.unassociated, associate(scene.unassociated, scene.rig, CONFIG), strict=True):
        assert after.time_ns == before.time_ns
        assert after.detections is before.detections
        views = [view for vehicle in after.vehicles for view in vehicle.views.items()]
        assert len(views) == len(set(views))
        assert [v.obj_id for v in after.vehicles] == list(range(len(after.vehicles)))


def test_it_is_deterministic() -> None:
    scene = crossing()
    first, second = (associate(scene.unassociated[:20], scene.rig, CONFIG) for _ in range(2))
    assert [i.vehicles for i in first] == [i.vehicles for i in second]


def test_statistics_count_views_and_what_is_left_over() -> None:
    seen = Detections2D("cam1", 0, np.zeros((2, 4)), np.ones(2), np.zeros(2, np.int64))
    other = Detections2D("cam2", 0, np.zeros((2, 4)), np.ones(2), np.zeros(2, np.int64))
    vehicles = (
        MultiViewVehicle(0, 0, RoadUserClass.CAR, 0.0, 0.0, {"cam1": 0, "cam2": 1}),
        MultiViewVehicle(1, -1, RoadUserClass.CAR, 9.0, 0.0, {"cam1": 1}),
    )
    statistics = association_statistics([AnnotatedInstant(0, {"cam1": seen, "cam2": other}, vehicles)]).model_dump()
    assert statistics["by_views"] == {"2": 1}
    assert statistics["single_view"] == 1
    assert statistics["unassociated_share"] == pytest.approx(0.5)
    assert statistics["tracks"] == 1


def test_no_boxes_at_all() -> None:
    instants = [AnnotatedInstant(0, {"cam1": no_boxes("cam1")})]
    with pytest.raises(NoVehicles, match="no vehicle was detected"):
        associate(instants, corner_rig(), CONFIG)


def test_boxes_that_are_all_out_of_range() -> None:
    scene = crossing()
    with pytest.raises(NoVehicles, match=r"within 0\.5 m"):
        associate(scene.unassociated[:3], scene.rig, AssociateConfig(range_m=0.5))


def test_cameras_that_never_meet() -> None:
    scene = crossing()
    elsewhere = CameraRig({f"cam{k + 1}": look_at((200.0 * k, -25.0, 8.0), (200.0 * k, 0.0, 0.0)) for k in range(2)})
    only_two = [AnnotatedInstant(i.time_ns, {c: i.detections[c] for c in ("cam1", "cam2")}) for i in scene.instants[:5]]
    with pytest.raises(NoMultiViewVehicles) as raised:
        associate(only_two, elsewhere, AssociateConfig(range_m=200.0))
    assert "calibration" in raised.value.hint


def test_cameras_that_may_be_turned_meet_farther_apart() -> None:
    """Two cameras whose rays of one vehicle end 3.6 m apart, since one of them is turned by 3 degrees."""
    rig = corner_rig(2)
    box = np.array([[1.0, 2.0, 0.75, 4.4, 1.8, 1.5, 0.3]])
    camera = rig["cam2"]
    by_3_deg = cv2.Rodrigues(np.radians([3.0, 0.0, 0.0]))[0]
    pose = SE3(camera.T_world_cam.rotation @ by_3_deg, camera.T_world_cam.translation)
    wrong = CameraRig({"cam1": rig["cam1"], "cam2": replace(camera, T_world_cam=pose)})
    one = np.zeros(1, np.int64)
    instants = [
        AnnotatedInstant(
            k * 100_000_000,
            {name: Detections2D(name, k * 100_000_000, project_boxes(rig[name], box), [0.9], one) for name in rig},
        )
        for k in range(3)
    ]
    covariance = np.diag([np.radians(3.0) ** 2] * 3 + [1e-6] * 3)
    with pytest.raises(NoMultiViewVehicles):
        associate(instants, wrong, AssociateConfig(cluster_radius_m=1.0))
    found = associate(instants, wrong, AssociateConfig(cluster_radius_m=1.0), poses=dict.fromkeys(rig, covariance))
    assert [[len(vehicle.views) for vehicle in instant.vehicles] for instant in found] == [[2], [2], [2]]
