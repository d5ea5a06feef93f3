"""Which instants are suggested, and what labelling starts from."""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders import corner_rig
from wibam_core.geometry.box3d import corners
from wibam_core.labelling.proposal import proposed
from wibam_core.labelling.suggestions import disagreement, suggest
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, MultiViewVehicle, Vehicles3D

RIG = corner_rig()
BOX = np.array([[1.0, 2.0, 0.75, 4.4, 1.8, 1.5, 0.4]])


def seen(rig: CameraRig, time_ns: int, box: np.ndarray) -> AnnotatedInstant:
    """What a perfect detector sees of one vehicle, of track 3."""
    detections = {}
    for camera_id, camera in rig.items():
        uv = camera.project(corners(box))[0]
        edges = np.concatenate([uv.min(axis=1), uv.max(axis=1)], axis=1)
        detections[camera_id] = Detections2D(camera_id, time_ns, edges, np.ones(1), np.zeros(1, np.int64))
    vehicle = MultiViewVehicle(0, 3, RoadUserClass.CAR, *box[0, :2].tolist(), dict.fromkeys(rig, 0))
    return AnnotatedInstant(time_ns, detections, (vehicle,))


def fit(time_ns: int, box: np.ndarray) -> Vehicles3D:
    return Vehicles3D.of(time_ns, box, ids=np.array([3]))


def test_a_fit_that_meets_all_views_leaves_no_disagreement() -> None:
    assert disagreement(seen(RIG, 0, BOX), fit(0, BOX), RIG) == pytest.approx(0.0, abs=1e-9)
    moved = BOX + [1.0, 0, 0, 0, 0, 0, 0]
    assert 0.1 < (disagreement(seen(RIG, 0, BOX), fit(0, moved), RIG) or 0.0) < 0.9


def test_a_vehicle_that_nobody_saw_says_nothing() -> None:
    assert disagreement(AnnotatedInstant(0, {}), fit(0, BOX), RIG) is None


def test_suggestions_are_spread_and_denser_where_the_cameras_disagree() -> None:
    times = list(range(40))
    doubtful = range(20, 30)
    fits = {t: fit(t, BOX + [1.0 if t in doubtful else 0.0, 0, 0, 0, 0, 0, 0]) for t in times}
    annotations = {t: seen(RIG, t, BOX) for t in times}
    chosen = [one.time_ns for one in suggest(times, fits, annotations, RIG, 8)]
    assert len(chosen) == 8 and chosen == sorted(set(chosen))
    assert sum(t in doubtful for t in chosen) >= 5, "a quarter of the time, but most of the doubt"
    assert min(chosen) < 10 and max(chosen) >= 30, "the rest is not forgotten"
    assert chosen == [one.time_ns for one in suggest(times, fits, annotations, RIG, 8)]
    others = [one.time_ns for one in suggest(times, fits, annotations, RIG, 100, left_out=chosen)]
    assert others == [t for t in times if t not in chosen]


def test_between_two_fits_a_vehicle_has_moved_part_of_the_way() -> None:
    turned = BOX + [4.0, 0, 0, 0, 0, 0, 0.2]
    fits = [fit(0, BOX), fit(400_000_000, turned)]
    [found] = proposed(fits, 100_000_000)
    np.testing.assert_allclose(found.box, (BOX + [1.0, 0, 0, 0, 0, 0, 0.05])[0])
    np.testing.assert_allclose(found.velocity_mps, [10.0, 0.0])
    assert found.id == 3
    assert proposed(fits, 500_000_000) == [], "nobody knows where it went"


def test_at_a_fit_it_stands_there_and_moves_as_its_neighbours_say() -> None:
    [first] = proposed([fit(0, BOX), fit(400_000_000, BOX + [4.0, 0, 0, 0, 0, 0, 0])], 0)
    np.testing.assert_allclose(first.box, BOX[0])
    np.testing.assert_allclose(first.velocity_mps, [10.0, 0.0])
    [alone] = proposed([fit(0, BOX)], 0)
    assert alone.velocity_mps == (0.0, 0.0)
