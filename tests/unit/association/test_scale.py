"""Road users that look too large or too small give a wrong calibration away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.multiview import Scene, crossing
from wibam_core.association.scale import apparent_size, size_cautions
from wibam_core.errors import CalibrationError
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import CameraRig


@pytest.fixture(scope="module")
def scene() -> Scene:
    return crossing(duration_s=3.0)


def in_other_world(rig: CameraRig, units_per_metre: float = 1.0, raised_by: float = 0.0) -> CameraRig:
    """The same cameras in a world of another unit, or whose road lies at another height."""
    return CameraRig(
        {
            camera_id: replace(
                camera,
                T_world_cam=SE3(
                    camera.T_world_cam.rotation, units_per_metre * camera.centre_m + np.array([0.0, 0.0, raised_by])
                ),
            )
            for camera_id, camera in rig.items()
        }
    )


def ratio(scene: Scene, rig: CameraRig, camera_id: str = "cam1") -> float:
    found = apparent_size(rig[camera_id], [i.detections[camera_id] for i in scene.unassociated])
    assert found is not None
    return found


def test_road_users_look_as_large_as_they_are(scene: Scene) -> None:
    assert ratio(scene, scene.rig) == pytest.approx(1.0, abs=0.15)
    assert size_cautions(scene.unassociated, scene.rig) == []


def test_a_world_in_feet_is_refused_by_name(scene: Scene) -> None:
    rig = in_other_world(scene.rig, 1 / 0.3048)
    assert ratio(scene, rig) == pytest.approx(ratio(scene, scene.rig) / 0.3048, rel=0.15)
    with pytest.raises(CalibrationError, match=r"camera cam1: road users look 3\.\d times as large") as refused:
        size_cautions(scene.unassociated, rig)
    assert "0.3048" in refused.value.hint


def test_a_road_far_below_the_plane_is_refused_and_one_a_little_below_is_warned_of(scene: Scene) -> None:
    with pytest.raises(CalibrationError, match="times as large") as refused:
        size_cautions(scene.unassociated, in_other_world(scene.rig, raised_by=34.0))
    assert "z = 0" in refused.value.hint
    height_m = scene.rig["cam1"].centre_m[2]
    cautions = size_cautions(scene.unassociated, in_other_world(scene.rig, raised_by=0.8 * height_m))
    assert [caution.code for caution in cautions] == ["apparent_size"] * len(scene.rig)
    assert cautions[0].details["camera"] == "cam1"


def test_a_world_too_small_is_warned_of(scene: Scene) -> None:
    assert size_cautions(scene.unassociated, in_other_world(scene.rig, 0.5))


def test_few_boxes_say_nothing(scene: Scene) -> None:
    seen = [instant.detections["cam1"] for instant in scene.unassociated]
    assert apparent_size(scene.rig["cam1"], seen[:1]) is None
