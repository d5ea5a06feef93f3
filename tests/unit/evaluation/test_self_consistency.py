from __future__ import annotations

import numpy as np
import pytest

from tests.builders import corner_rig
from wibam_core.evaluation.self_consistency import self_consistency
from wibam_core.geometry.projection import project_boxes
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, MultiViewVehicle, VehicleClass, Vehicles3D

RIG = corner_rig(3)
TRUTH = np.array([[0.0, 0, 0.75, 4.5, 1.8, 1.5, 0.4], [6.0, 5, 0.75, 4.2, 1.8, 1.5, 2.0]])


def annotate(rig: CameraRig) -> AnnotatedInstant:
    detections = {
        camera_id: Detections2D(camera_id, 0, project_boxes(camera, TRUTH), np.ones(2), np.zeros(2, int))
        for camera_id, camera in rig.items()
    }
    vehicles = tuple(MultiViewVehicle(i, i, VehicleClass.CAR, *TRUTH[i, :2], dict.fromkeys(rig, i)) for i in range(2))
    return AnnotatedInstant(0, detections, vehicles)


def found(offset: float) -> list[Vehicles3D]:
    return [Vehicles3D.of(0, TRUTH + [offset, 0, 0, 0, 0, 0, 0], camera_id=camera_id) for camera_id in RIG]


def test_true_boxes_agree_in_every_view() -> None:
    result = self_consistency(found(0.0), [annotate(RIG)], RIG)
    assert result["other_views"]["mean"] == pytest.approx(1)
    assert result["own_view"]["mean"] == pytest.approx(1)
    assert result["found"] == 1
    assert result["pairs"] == 3 * 2 * 2


def test_a_displaced_box_agrees_less() -> None:
    near, far = (self_consistency(found(d), [annotate(RIG)], RIG)["other_views"]["mean"] for d in (0.3, 0.9))
    assert far < near < 1


def test_a_box_wrong_along_the_ray_fits_its_own_view_but_not_the_others() -> None:
    camera = RIG["cam1"]
    away = TRUTH.copy()
    away[:, :3] += 0.15 * (away[:, :3] - camera.centre_m)
    away[:, 3:6] *= 1.15
    result = self_consistency([Vehicles3D.of(0, away, camera_id="cam1")], [annotate(RIG)], RIG)
    assert result["own_view"]["mean"] == pytest.approx(1)
    assert result["other_views"]["mean"] < 0.5


def test_without_detections_or_views_there_is_nothing_to_average() -> None:
    empty = [Vehicles3D.of(0, np.empty((0, 7)), camera_id=camera_id) for camera_id in RIG]
    result = self_consistency(empty, [annotate(RIG)], RIG)
    assert result["found"] == 0
    assert result["other_views"] == {"mean": None, "sd": None}
    assert self_consistency([], [], RIG)["found"] is None
