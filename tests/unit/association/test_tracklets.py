from __future__ import annotations

import numpy as np

from wibam_core.association.tracklets import tracklets
from wibam_core.scene import AnnotatedInstant, Detections2D

PERIOD_NS = 80_000_000


def seen(step: int, camera_id: str, boxes: list[tuple[float, ...]]) -> Detections2D:
    n = len(boxes)
    return Detections2D(
        camera_id, step * PERIOD_NS, np.array(boxes, float).reshape(-1, 4), np.ones(n), np.zeros(n, np.int64)
    )


def instants(boxes: list[list[tuple[float, ...]]], camera_id: str = "cam1") -> list[AnnotatedInstant]:
    return [AnnotatedInstant(k * PERIOD_NS, {camera_id: seen(k, camera_id, own)}) for k, own in enumerate(boxes)]


def car(x: float, y: float = 100.0) -> tuple[float, ...]:
    return (x, y, x + 60.0, y + 40.0)


def test_vehicles_that_pass_each_other_keep_their_numbers() -> None:
    """One in front of the other, so that for a moment they are in the same place."""
    found = tracklets(instants([[car(6.0 * k), car(300.0 - 6.0 * k, 108.0)] for k in range(50)]), ["cam1"], 0.5)
    assert all(ids["cam1"].tolist() == [0, 1] for ids in found)


def test_the_order_of_boxes_does_not_matter() -> None:
    boxes = [[car(0.0), car(200.0)], [car(202.0), car(2.0)], [car(4.0), car(204.0)]]
    assert [ids["cam1"].tolist() for ids in tracklets(instants(boxes), ["cam1"], 0.5)] == [[0, 1], [1, 0], [0, 1]]


def test_a_short_gap_is_bridged_at_the_vehicle_s_speed_and_a_long_one_is_not() -> None:
    for gap, count in ((5, 1), (8, 2)):
        boxes = [[car(12.0 * k)] if not 10 <= k < 10 + gap else [] for k in range(30)]
        names = {int(i) for ids in tracklets(instants(boxes), ["cam1"], 0.5) for i in ids["cam1"]}
        assert len(names) == count


def test_a_vehicle_that_passes_a_standing_one_does_not_take_its_number() -> None:
    """For a moment one box alone is found of both."""
    boxes = []
    for k in range(40):
        passing = car(8.0 * k, 112.0)
        boxes.append([passing] if abs(8.0 * k - 150.0) < 30.0 else [car(150.0), passing])
    found = [ids["cam1"].tolist() for ids in tracklets(instants(boxes), ["cam1"], 0.5)]
    assert {ids[-1] for ids in found} == {1}
    assert {ids[0] for ids in found if len(ids) == 2} <= {0, 2}


def test_after_a_while_a_vehicle_may_be_farther_off() -> None:
    for step, count in ((1, 2), (5, 1)):  # the same shift after 0.08 s and after 0.4 s
        boxes = [[car(0.0)], *[[]] * (step - 1), [car(20.0)]]
        names = {int(i) for ids in tracklets(instants(boxes), ["cam1"], 0.5) for i in ids["cam1"]}
        assert len(names) == count


def test_a_box_that_is_lost_for_too_long_begins_anew() -> None:
    boxes = [[car(0.0)], *[[]] * 9, [car(0.0)]]  # 0.8 s
    for max_gap_s, count in ((0.5, 2), (1.0, 1)):
        names = {int(i) for ids in tracklets(instants(boxes), ["cam1"], max_gap_s) for i in ids["cam1"]}
        assert len(names) == count


def test_a_box_elsewhere_is_another_vehicle() -> None:
    found = tracklets(instants([[car(0.0)], [car(90.0)]]), ["cam1"], 0.5)
    assert [ids["cam1"].tolist() for ids in found] == [[0], [1]]


def test_what_is_hidden_of_a_vehicle_does_not_end_it() -> None:
    """Its amodal box stays; that of what is seen jumps."""
    whole = np.array([car(0.0)])
    found = []
    for k, shown in enumerate((car(0.0), (45.0, 100.0, 60.0, 140.0), car(0.0))):
        one = Detections2D(
            "cam1",
            k * PERIOD_NS,
            np.array([shown]),
            np.ones(1),
            np.zeros(1, np.int64),
            amodal_boxes=whole,
            amodal_sd=np.ones((1, 4)),
        )
        found.append(AnnotatedInstant(k * PERIOD_NS, {"cam1": one}))
    assert [ids["cam1"].tolist() for ids in tracklets(found, ["cam1"], 0.5)] == [[0], [0], [0]]


def test_numbers_of_cameras_differ_and_a_camera_may_miss_instants() -> None:
    both = [
        AnnotatedInstant(0, {"cam1": seen(0, "cam1", [car(0.0)]), "cam2": seen(0, "cam2", [car(0.0)])}),
        AnnotatedInstant(PERIOD_NS, {"cam2": seen(1, "cam2", [])}),
        AnnotatedInstant(2 * PERIOD_NS, {"cam1": seen(2, "cam1", [car(1.0)]), "cam2": seen(2, "cam2", [car(1.0)])}),
    ]
    found = tracklets(both, ["cam1", "cam2"], 0.5)
    assert [{camera: ids.tolist() for camera, ids in of.items()} for of in found] == [
        {"cam1": [0], "cam2": [1]},
        {"cam2": []},
        {"cam1": [0], "cam2": [1]},
    ]
    assert tracklets([], ["cam1"], 0.5) == []
