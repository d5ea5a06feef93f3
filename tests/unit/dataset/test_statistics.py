from __future__ import annotations

import json

import numpy as np
import pytest

from tests.builders import corner_rig
from wibam_core.dataset.statistics import dataset_statistics
from wibam_core.documents.split import SUBSETS, Split
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, MultiViewVehicle


def test_counts_and_distributions() -> None:
    rig = corner_rig(radius_m=20.0, height_m=8.0)
    car = MultiViewVehicle(0, 4, RoadUserClass.CAR, 0.0, 0.0, {"cam1": 0, "cam2": 0, "cam3": 0})
    bus = MultiViewVehicle(1, 5, RoadUserClass.BUS, 0.0, 0.0, {"cam1": 1, "cam2": 1})
    alone = MultiViewVehicle(2, 6, RoadUserClass.CAR, 0.0, 0.0, {"cam4": 1})
    instants = [AnnotatedInstant(t, {}, (car, bus, alone) if t < 3 else (car,)) for t in range(6)]
    split = Split(
        times_ns={"train": (0, 1, 2), "val": (3,), "test": (5,)},
        left_out_tracks={"train": frozenset({4}), "val": frozenset({4}), "test": frozenset()},
    )
    found = dataset_statistics(instants, rig, split).model_dump()
    json.dumps(found, allow_nan=False)
    train = {k: found["subsets"]["train"][k] for k in ("instants", "vehicles", "boxes", "tracks", "left_out_tracks")}
    assert train == {"instants": 3, "vehicles": 6, "boxes": 15, "tracks": 2, "left_out_tracks": 1}
    assert found["by_views"] == {"2": 3, "3": 5}
    assert found["by_class"] == {"car": 5, "bus": 3}
    assert found["boxes_by_camera"] == {"cam1": 8, "cam2": 8, "cam3": 5, "cam4": 0}
    for name in ("depth_m", "elevation_deg"):
        assert sum(found[name]["counts"]) == 21
        assert len(found[name]["edges"]) == len(found[name]["counts"]) + 1
    # all stand in the middle: 20 m away on the ground, 7.25 m below the camera
    low, high = found["elevation_deg"]["edges"][0], found["elevation_deg"]["edges"][-1]
    assert low <= np.degrees(np.arctan2(7.25, 20.0)) < high
    assert found["depth_m"]["edges"][0] == pytest.approx(20.0)


def test_an_empty_set_still_has_histograms() -> None:
    nobody: dict[str, frozenset[int]] = dict.fromkeys(SUBSETS, frozenset())
    split = Split(times_ns={"train": (0,), "val": (1,), "test": (2,)}, left_out_tracks=nobody)
    found = dataset_statistics([AnnotatedInstant(t, {}) for t in range(3)], corner_rig(), split)
    assert found.depth_m.counts == [0]
    assert found.vehicles_per_instant.counts == [3]
