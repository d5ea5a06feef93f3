"""Cameras whose road users meet those of others by chance alone give a mistake away that no calibration shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.builders import look_at
from tests.multiview import Scene, record, traffic
from wibam_core.association.agreement import agreement_cautions
from wibam_core.geometry.box3d import corners
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D


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


def parked(moving: int, share: float = 0.45, seed: int = 0) -> tuple[list[AnnotatedInstant], CameraRig]:
    """20 parked cars, of which two cameras see a random share each, and some that drive past, one after another."""
    rng = np.random.default_rng(seed)
    rig = CameraRig({"a": look_at((26.0, 4.0, 8.0)), "b": look_at((-6.0, 27.0, 8.0))})
    stand = [np.array([x, y, 0.75, 4.4, 1.8, 1.5, 0.0]) for x in np.linspace(-13.0, 13.0, 5) for y in (-9, -5, 5, 9)]
    instants = []
    for step in range(150):
        drive = [np.array([step / 150 * 60 - 30 + 8.0 * k, 0.0, 0.75, 4.4, 1.8, 1.5, 0.0]) for k in range(moving)]
        seen = {}
        for name, camera in rig.items():
            shown = [box for box in stand if rng.random() < share] + [box for box in drive if rng.random() < 0.9]
            outlines = [camera.project(corners(box))[0] for box in shown]
            pixels = np.array([np.concatenate([uv.min(axis=0), uv.max(axis=0)]) for uv in outlines]).reshape(-1, 4)
            inside = (pixels[:, :2] > 0).all(axis=1) & (pixels[:, 2:] < [camera.width_px, camera.height_px]).all(axis=1)
            count = int(inside.sum())
            seen[name] = Detections2D(name, step, pixels[inside], np.full(count, 0.9), np.zeros(count, dtype=np.int64))
        instants.append(AnnotatedInstant(step, seen))
    return instants, rig


@pytest.mark.parametrize("moving", [0, 1, 2])
@pytest.mark.parametrize("share", [0.3, 0.45, 0.7])
def test_parked_cars_that_each_camera_sees_now_and_then_say_nothing(moving: int, share: float) -> None:
    assert agreement_cautions(*parked(moving, share)) == []


def test_who_moves_among_parked_cars_gives_a_shifted_camera_away() -> None:
    instants, rig = parked(2)
    shifted = moved(rig, "b", SE3.from_rvec_tvec(np.zeros(3), np.array([0.0, 12.0, 0.0])))
    assert {caution.details["camera"] for caution in agreement_cautions(instants, shifted)} == {"a", "b"}
