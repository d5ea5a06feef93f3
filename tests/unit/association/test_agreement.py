"""Cameras whose road users meet those of others by chance alone give a mistake away that no calibration shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.builders import look_at
from tests.multiview import Scene, record, traffic
from wibam_core.association.agreement import agreement_cautions
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import AnnotatedInstant, CameraRig


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Cameras whose exchange looks like no turn of the crossing."""
    places = ((24.0, 6.0, 8.0), (-9.0, 25.0, 7.0), (-26.0, -14.0, 9.0), (15.0, -19.0, 7.5))
    rig = CameraRig({f"cam{number + 1}": look_at(place) for number, place in enumerate(places)})
    moving = traffic(1, 8.0, start_s=-22.0)
    return record(rig, moving, duration_s=8.0, seed=1, offset_ns=10_000_000, jitter=0.02)


def moved(rig: CameraRig, camera_id: str, T: SE3) -> CameraRig:
    """The rig with one camera in a world of its own."""
    return CameraRig(
        {name: replace(c, T_world_cam=T @ c.T_world_cam) if name == camera_id else c for name, c in rig.items()}
    )


def exchanged(instants: list[AnnotatedInstant], one: str, other: str) -> list[AnnotatedInstant]:
    swap = {one: other, other: one}
    return [
        AnnotatedInstant(
            i.time_ns,
            {name: replace(i.detections[swap.get(name, name)], camera_id=name) for name in i.detections},
        )
        for i in instants
    ]


def test_cameras_that_see_the_same_are_fine(scene: Scene) -> None:
    assert agreement_cautions(scene.unassociated, scene.rig) == []


@pytest.mark.parametrize(("degrees", "shift_m"), [(90.0, 0.0), (0.0, 18.0)])
def test_a_camera_in_a_world_of_its_own_is_named(scene: Scene, degrees: float, shift_m: float) -> None:
    own_world = SE3.from_rvec_tvec(np.radians([0.0, 0.0, degrees]), np.array([shift_m, 0.3 * shift_m, 0.0]))
    [caution] = agreement_cautions(scene.unassociated, moved(scene.rig, "cam2", own_world))
    assert (caution.code, caution.details["camera"]) == ("camera_disagrees", "cam2")
    assert caution.details["exchanged"] is None and "another world" in caution.hint


def test_exchanged_recordings_are_named(scene: Scene) -> None:
    found = agreement_cautions(exchanged(scene.unassociated, "cam1", "cam4"), scene.rig)
    assert {caution.details["camera"]: caution.details["exchanged"] for caution in found} == {
        "cam1": "cam4",
        "cam4": "cam1",
    }
    assert "look exchanged" in found[0].hint


def test_a_clock_that_is_off_by_seconds_is_said(scene: Scene) -> None:
    instants = scene.unassociated
    late = [
        AnnotatedInstant(i.time_ns, {**i.detections, "cam3": later.detections["cam3"]})
        for i, later in zip(instants, [*instants[20:], *instants[:20]], strict=True)
    ]
    assert [caution.details["camera"] for caution in agreement_cautions(late, scene.rig)] == ["cam3"]


def test_few_road_users_say_nothing(scene: Scene) -> None:
    assert agreement_cautions(exchanged(scene.unassociated, "cam1", "cam4")[:3], scene.rig) == []
