from __future__ import annotations

import numpy as np

from tests.builders import corner_rig
from tests.multiview import crossing
from wibam_core.lifting.observations import Observations, cut_by_border, observe
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, Detections2D, MultiViewVehicle


def test_edges_at_the_border_are_cut() -> None:
    boxes = np.array([[-0.5, 50, 100, 150], [200, 100, 300, 358.9], [630, -0.5, 639.5, 40], [300, 100, 340, 130]])
    assert cut_by_border(boxes, 640, 360).tolist() == [
        [True, False, False, False],
        [False, False, False, True],
        [False, True, True, False],
        [False, False, False, False],
    ]


def test_a_large_box_may_miss_the_border_by_its_jitter() -> None:
    assert cut_by_border(np.array([[7.0, 100, 247, 200], [7.0, 100, 27, 112]]), 640, 360)[:, 0].tolist() == [
        True,
        False,
    ]


def test_observations_hold_every_view_of_vehicles_with_enough_views() -> None:
    scene = crossing()
    seen = observe(scene.instants, scene.rig, 3)
    wanted = [
        (i, n, v)
        for i, instant in enumerate(scene.instants)
        for n, v in enumerate(instant.vehicles)
        if len(v.views) >= 3
    ]
    assert len(seen) == len(wanted)
    for row, (i, n, vehicle) in enumerate(wanted):
        assert (seen.instants[row], seen.vehicles[row], seen.tracks[row]) == (i, n, vehicle.track_id)
        assert seen.seen[row].sum() == len(vehicle.views)
        for slot in np.flatnonzero(seen.seen[row]):
            camera_id = list(scene.rig)[seen.cameras[row, slot]]
            box = scene.instants[i].detections[camera_id].boxes[vehicle.views[camera_id]]
            assert np.array_equal(seen.boxes[row, slot], box)


def test_amodal_edges_are_compared_by_what_they_state_even_where_a_nearer_vehicle_hides_them() -> None:
    far, near = [100.0, 100, 180, 140], [150.0, 90, 260, 170]
    amodal = np.array([[100.0, 100, 190, 140], near])
    sd = np.array([[1.0, 2, 9, 2], [1, 1, 1, 1]])
    vehicles = (
        MultiViewVehicle(0, 3, RoadUserClass.CAR, 30.0, 30.0, {"cam1": 0}),
        MultiViewVehicle(1, 4, RoadUserClass.CAR, 10.0, 10.0, {"cam1": 1}),
    )

    def edges(*known: np.ndarray) -> Observations:
        seen = Detections2D("cam1", 0, np.array([far, near]), np.ones(2), np.zeros(2, np.int64), *known)
        return observe([AnnotatedInstant(0, {"cam1": seen}, vehicles)], corner_rig(), 1)

    plain, known = edges(), edges(amodal, sd)
    hidden = int(plain.positions[:, 0].argmax())
    assert plain.exact[hidden, 0].tolist() == [True, False, False, False]
    assert np.allclose(plain.edge_sd[hidden, 0], np.hypot(1.0, [0.03 * 80, 0.03 * 40] * 2))
    assert known.exact[hidden, 0].all()
    assert known.boxes[hidden, 0].tolist() == amodal[0].tolist()
    assert np.allclose(known.edge_sd[hidden, 0], np.hypot(0.3, sd[0]))


def test_lateness_is_the_exposure_after_the_instant() -> None:
    box = np.array([[100.0, 100, 140, 120]])
    detections = {
        c: Detections2D(c, 1_000_000_000 + late, box, np.ones(1), np.zeros(1, np.int64))
        for c, late in (("cam1", 20_000_000), ("cam2", -10_000_000))
    }
    vehicle = MultiViewVehicle(0, 3, RoadUserClass.CAR, 0.0, 0.0, {"cam1": 0, "cam2": 0})
    seen = observe([AnnotatedInstant(1_000_000_000, detections, (vehicle,))], corner_rig(), 2)
    assert np.allclose(seen.lateness_s[0, :2], [0.02, -0.01])


def test_no_vehicle_gives_no_row() -> None:
    assert len(observe([AnnotatedInstant(0, {})], corner_rig(), 2)) == 0
