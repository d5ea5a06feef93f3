from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.builders import corner_rig
from wibam_core.evaluation.self_consistency import Agreement, roughness, self_consistency
from wibam_core.geometry.projection import project_boxes
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, MultiViewVehicle, Vehicles3D

RIG = corner_rig(3)
TRUTH = np.array([[0.0, 0, 0.75, 4.5, 1.8, 1.5, 0.4], [6.0, 5, 0.75, 4.2, 1.8, 1.5, 2.0]])


def annotate(rig: CameraRig) -> AnnotatedInstant:
    detections = {
        camera_id: Detections2D(camera_id, 0, project_boxes(camera, TRUTH), np.ones(2), np.zeros(2, int))
        for camera_id, camera in rig.items()
    }
    vehicles = tuple(MultiViewVehicle(i, i, RoadUserClass.CAR, *TRUTH[i, :2], dict.fromkeys(rig, i)) for i in range(2))
    return AnnotatedInstant(0, detections, vehicles)


def found(offset: float) -> list[Vehicles3D]:
    return [Vehicles3D.of(0, TRUTH + [offset, 0, 0, 0, 0, 0, 0], camera_id=camera_id) for camera_id in RIG]


def test_true_boxes_agree_in_every_view() -> None:
    result = self_consistency(found(0.0), [annotate(RIG)], RIG).model_dump()
    assert result["other_views"]["mean"] == pytest.approx(1)
    assert result["own_view"]["mean"] == pytest.approx(1)
    assert result["found"] == 1
    assert result["pairs"] == 3 * 2 * 2


def test_a_displaced_box_agrees_less() -> None:
    near, far = (self_consistency(found(d), [annotate(RIG)], RIG).other_views.mean for d in (0.3, 0.9))
    assert far < near < 1


def test_a_box_wrong_along_the_ray_fits_its_own_view_but_not_the_others() -> None:
    camera = RIG["cam1"]
    away = TRUTH.copy()
    away[:, :3] += 0.15 * (away[:, :3] - camera.centre_m)
    away[:, 3:6] *= 1.15
    result = self_consistency([Vehicles3D.of(0, away, camera_id="cam1")], [annotate(RIG)], RIG).model_dump()
    assert result["own_view"]["mean"] == pytest.approx(1)
    assert result["other_views"]["mean"] < 0.5


def test_without_detections_or_views_there_is_nothing_to_average() -> None:
    empty = [Vehicles3D.of(0, np.empty((0, 7)), camera_id=camera_id) for camera_id in RIG]
    result = self_consistency(empty, [annotate(RIG)], RIG).model_dump()
    assert result["found"] == 0
    assert result["other_views"] == {"mean": None, "sd": None}
    assert self_consistency([], [], RIG).found is None


def sighting(time_s: float, x_m: float, y_m: float = 0.0, camera_id: str = "a", track_id: int = 1) -> Agreement:
    return Agreement(round(time_s * 1e9), camera_id, 0, track_id, time_s, x_m, y_m, 1.0, (1.0,))


def test_steady_motion_is_smooth_whenever_frames_are_exposed() -> None:
    times = [0.0, 0.43, 0.79, 1.2]
    np.testing.assert_allclose(roughness([sighting(t, 10 * t, -3 * t) for t in times]), [0, 0], atol=1e-12)


def test_a_box_beside_the_line_is_rough_by_its_distance() -> None:
    found = [sighting(0.0, 0.0), sighting(0.4, 4.0, 0.5), sighting(0.8, 8.0)]
    np.testing.assert_allclose(roughness(found[::-1]), [0.5])


def test_only_one_vehicles_boxes_of_one_camera_close_in_time_are_compared() -> None:
    assert not len(roughness([sighting(0.0, 0.0), sighting(0.4, 4.0, camera_id="b"), sighting(0.8, 8.0)]))
    assert not len(roughness([sighting(0.0, 0.0), sighting(0.4, 4.0, track_id=2), sighting(0.8, 8.0)]))
    assert not len(roughness([sighting(0.4 * k, k, track_id=-1) for k in range(5)]))
    assert not len(roughness([sighting(0.0, 0.0), sighting(1.4, 4.0), sighting(1.8, 8.0)]))


def test_predictions_over_time_have_a_roughness() -> None:
    instants, predicted = [], []
    for k in range(4):
        time_ns = k * 400_000_000
        one = annotate(RIG)
        detections = {c: Detections2D(c, time_ns, d.boxes, d.scores, d.classes) for c, d in one.detections.items()}
        instants.append(AnnotatedInstant(time_ns, detections, one.vehicles))
        sideways = 0.2 * (-1) ** k
        predicted += [Vehicles3D.of(time_ns, TRUTH + [sideways, 0, 0, 0, 0, 0, 0], camera_id=c) for c in RIG]
    assert self_consistency(predicted, instants, RIG).roughness_m.mean == pytest.approx(0.4)


def test_a_network_is_not_asked_for_what_it_does_not_know() -> None:
    instant = annotate(RIG)
    walker = replace(instant.vehicles[1], vehicle_class=RoadUserClass.PEDESTRIAN)
    instant = replace(instant, vehicles=(instant.vehicles[0], walker))
    cars_alone = [vehicles.where(np.array([0])) for vehicles in found(0.0)]
    assert self_consistency(cars_alone, [instant], RIG).found == 0.5
    assert self_consistency(cars_alone, [instant], RIG, [RoadUserClass.CAR]).found == 1
