"""What of a result hand labels can judge: areas, what counts neither way, counts and intervals."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.real_labels import Area, Labels, bootstrap, figures, judge, read_area, read_labels, wilson
from benchmarks.real_measures import fits_at, of_one_camera, of_what_may_teach, parts, subset_at, tracks_at
from benchmarks.real_sites import written
from tests.builders import look_at
from wibam_core.documents.split import Split
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, CameraRig, FrameSet, MultiViewVehicle, Track, Vehicles3D

S = 10**9
SQUARE = Area(np.array([[-10.0, -10.0], [10.0, -10.0], [10.0, 10.0], [-10.0, 10.0]]))


def car(x: float, y: float, yaw: float = 0.0) -> list[float]:
    return [x, y, 0.75, 4.4, 1.8, 1.5, yaw]


def labels(*cars: list[float], velocity: tuple[float, float] = (0.0, 0.0), ignored: np.ndarray | None = None) -> Labels:
    names = tuple(f"v{k}" for k in range(len(cars)))
    seen = {"a": np.array([1.0, 0.1, *[1.0] * len(cars)][: len(cars)])}
    nothing = np.empty((0, 5)) if ignored is None else ignored
    return Labels(S, names, np.array(cars), np.tile(velocity, (len(cars), 1)), seen, nothing)


def test_the_distance_from_the_border_is_positive_inside() -> None:
    places = np.array([[0.0, 0.0], [9.0, 3.0], [12.0, 0.0], [13.0, 14.0]])
    assert SQUARE.border_m(places) == pytest.approx([10.0, 1.0, -2.0, -5.0])


def test_found_missed_and_false_boxes() -> None:
    judged = judge(
        labels(car(0, 0), car(6, 0), car(14, 0)), SQUARE, np.array([car(0.5, 0, 0.1), car(-6, -6), car(14, 0)])
    )
    assert judged.asked == ("v0", "v1") and judged.found == ("v0",) and judged.false == 1
    assert judged.ate_m == pytest.approx([0.5]) and judged.aoe_deg == pytest.approx([np.degrees(0.1)])
    assert 0.6 < judged.bev_iou[0] < 0.9


def test_what_lies_close_to_the_border_outside_or_on_a_trailer_counts_neither_way() -> None:
    trailer = np.array([[-5.0, 5.0, 5.5, 2.2, np.pi / 2]])
    boxes = np.array([car(9.8, 0), car(11, 5), car(-5.5, 7.0), car(-4.6, 4.0)])
    assert judge(labels(car(0, 0), ignored=trailer), SQUARE, boxes).false == 0
    assert judge(labels(car(0, 0)), SQUARE, boxes).false == 2


def test_labels_move_to_when_a_frame_was_exposed() -> None:
    one = labels(car(0, 0), velocity=(10.0, 0.0))
    assert judge(one, SQUARE, np.array([car(1.0, 0)]), S + S // 10).ate_m == pytest.approx([0.0])


def test_one_camera_is_asked_for_what_it_sees_within_range_alone() -> None:
    camera = look_at((0.0, -20.0, 6.0), focal_px=500.0, width_px=640, height_px=360)
    one = labels(car(0, 0), car(5, 5), car(-8, 9))  # it sees the second too little
    instants = [FrameSet(S, {"a": S}, {"a": S})]

    def detect(instant: FrameSet, camera_id: str) -> Vehicles3D:
        return Vehicles3D.of(instant.time_ns, np.array([car(0, 0.3), car(5, 5.2), car(-3, -4)]), camera_id=camera_id)

    ((_, name, judged),) = of_one_camera([one], SQUARE, CameraRig({"a": camera}), instants, detect, max_range_m=28.0)
    assert name == "a" and judged.asked == ("v0",) and judged.found == ("v0",) and judged.false == 1


def test_tracks_are_taken_between_their_states_and_fits_are_moved_by_their_track() -> None:
    times_ns = np.array([0, S], dtype=np.int64)
    boxes = np.array([car(0, 0, 3.1), car(4, 0, -3.1)])
    track = Track(1, RoadUserClass.CAR, times_ns, boxes, np.ones((2, 7)), np.zeros((2, 2)), np.zeros(2))
    (box,) = tracks_at([track], S // 2)
    assert box[0] == pytest.approx(2.0) and abs(box[6]) == pytest.approx(np.pi)
    assert len(tracks_at([track], 2 * S)) == 0
    ids = np.array([4])
    fits = [Vehicles3D.of(k * 4 * S // 10, np.array([car(3.0 * k, 0)]), ids=ids) for k in range(3)]
    found = fits_at(fits, S // 2)
    assert found is not None and found[:, 0] == pytest.approx([3.75])
    assert fits_at(fits, 3 * S) is None


def test_who_is_left_out_of_a_part_is_not_asked_of_what_may_teach() -> None:
    split = Split(
        times_ns={"train": (0, 2 * S), "val": (4 * S, 5 * S), "test": (9 * S, 12 * S)},
        left_out_tracks={"train": frozenset({8}), "val": frozenset({7}), "test": frozenset()},
    )
    one = labels(car(0, 0), car(6, 0), car(0, 7))  # at 1 s
    seen = [MultiViewVehicle(k, k + 7, RoadUserClass.CAR, 6.0 * k + 0.4, 0.3, {"a": k, "b": k}) for k in range(2)]
    fits = [Vehicles3D.of(S, np.array([car(0.1, 0)]), ids=np.array([7]))]
    (_, judged), *others = of_what_may_teach([one], SQUARE, fits, [AnnotatedInstant(S, {}, tuple(seen))], split)
    # the second is left out of the training part; nothing was associated with the third, which was missed
    assert judged.asked == ("v0", "v2") and judged.found == ("v0",) and not others


def test_figures_count_and_state_intervals() -> None:
    right = judge(labels(car(0, 0), car(6, 0)), SQUARE, np.array([car(0, 0), car(6.4, 0), car(-7, 0)]))
    of = figures([right, right])
    assert (of["asked"], of["found"], of["false"], of["vehicles"]) == (4, 4, 2, 2)
    assert of["recall"] == 1.0 and of["precision"] == pytest.approx(4 / 6)
    assert of["ate_m"] == pytest.approx(0.2)
    nothing = figures([])
    assert nothing["recall"] is None and nothing["ate_m"] is None and nothing["bev_iou_interval"] is None


def test_a_shift_that_all_vehicles_share_is_told_apart() -> None:
    vehicles = [car(0, 0), car(8, 0), car(0, 8)]
    shifted = np.array([car(0.2, 0.5), car(8.4, 0.5), car(0.3, 8.5)])  # together by 0.3 and 0.5 m, and 0.1 m each way
    of = figures([judge(labels(*vehicles), SQUARE, shifted)])
    assert np.allclose(of["shift_m"], (0.3, 0.5)) and of["ate_m_unshifted"] == pytest.approx(0.2 / 3)
    assert of["bev_iou_unshifted"] > 0.9 > of["bev_iou"]  # type: ignore[operator]
    assert figures([judge(labels(vehicles[0]), SQUARE, shifted[:1])])["shift_m"] is None


def test_wilsons_interval_is_the_published_one() -> None:
    assert wilson(15, 20) == pytest.approx((0.531, 0.888), abs=1e-3)  # Newcombe 1998, method 3: 0.5313 to 0.8881
    low, high = wilson(25, 25) or (0.0, 0.0)
    assert low == pytest.approx(0.867, abs=1e-3) and high == pytest.approx(1.0)


def test_vehicles_are_drawn_as_a_whole() -> None:
    values = np.array([0.0, 0.0, 0.0, 0.0, 1.0])
    of_one_each = bootstrap(values, ["a", "b", "c", "d", "e"], 0)
    of_two = bootstrap(values, ["a", "a", "a", "a", "b"], 0)
    assert of_one_each is not None and of_two is not None and of_two[1] == 1.0 and of_one_each[1] < 0.8
    assert bootstrap(values, ["a"] * 5, 0) is None


def test_parts_follow_the_split() -> None:
    split = Split(
        times_ns={"train": (0, 4 * S), "val": (6 * S, 7 * S), "test": (9 * S, 12 * S)},
        left_out_tracks=dict.fromkeys(("train", "val", "test"), frozenset()),
    )
    assert [subset_at(split, t * S) for t in (1, 5, 6, 10, 20)] == ["train", "gap", "val", "test", "gap"]
    one = labels(car(0, 0))  # at 1 s
    found = parts([(one, judge(one, SQUARE, np.array([car(0, 0)])))], split)
    assert {name: len(of) for name, of in found.items()} == {"all": 1, "train": 1}


def test_labels_and_area_are_read(tmp_path: Path) -> None:
    row = {"time_ns": S, "vehicle_id": 3, "x_m": 1.0, "y_m": 2.0, "length_m": 4.0, "width_m": 1.8, "height_m": 1.5}
    row |= {"yaw_rad": 0.3, "visibility": {"a": 0.9}, "vx_mps": 5.0, "vy_mps": -1.0}
    (tmp_path / "labels.json").write_text(json.dumps([row]))
    trailer = {"time_ns": S, "x_m": 4, "y_m": 5, "length_m": 5.5, "width_m": 2.2, "yaw_rad": 0.1}
    (tmp_path / "area.json").write_text(json.dumps({"polygon_m": SQUARE.corners.tolist(), "ignore": [trailer]}))
    area, ignored = read_area(tmp_path / "area.json")
    (one,) = read_labels(tmp_path / "labels.json", ignored)
    assert one.boxes.tolist() == [[1.0, 2.0, 0.75, 4.0, 1.8, 1.5, 0.3]] and one.vehicle_ids == ("3",)
    assert one.velocities_mps.tolist() == [[5.0, -1.0]] and one.ignored.shape == (1, 5)
    assert area.corners.shape == (4, 2)


def test_a_row_takes_the_place_of_the_same_run(tmp_path: Path) -> None:
    path = tmp_path / "rows.json"
    row = {"site": "s", "detector": "d", "rounds_asked": 0, "steps": 200, "seed": 0, "options": [], "recall": 0.5}
    written(path, row)
    written(path, {**row, "seed": 1})
    rows = written(path, {**row, "recall": 0.9})
    assert [(one["seed"], one["recall"]) for one in rows] == [(0, 0.9), (1, 0.5)]
