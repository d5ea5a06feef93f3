from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.builders import look_at
from wibam_core.config import EvaluateConfig
from wibam_core.evaluation.evaluate import evaluate
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.evaluation.matching import assign, match_in_image, match_on_ground, paper_filter
from wibam_core.evaluation.metrics import METRICS, alias_share, compare, compare_as_published, scale_error
from wibam_core.evaluation.summary import by_class, by_distance, by_elevation, by_visibility, summarise
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import LabelledInstant, Vehicles3D

CAMERA = look_at((-25.0, 0.0, 8.0))
RIG = {"a": CAMERA}


def boxes(*places: tuple[float, float], yaw: float = 0.3, height: float = 1.5) -> np.ndarray:
    return np.array([[x, y, height / 2, 4.5, 1.8, height, yaw] for x, y in places]).reshape(-1, 7)


def labelled(
    truth: np.ndarray, visibility: list[float], time_ns: int = 0, ids: list[int] | None = None
) -> LabelledInstant:
    vehicles = Vehicles3D.of(time_ns, truth, ids=np.arange(len(truth)) if ids is None else np.array(ids))
    return LabelledInstant(vehicles, {"a": np.array(visibility)})


def detected(found: np.ndarray, time_ns: int = 0, scores: list[float] | None = None) -> Vehicles3D:
    return Vehicles3D.of(time_ns, found, scores=None if scores is None else np.array(scores), camera_id="a")


def run(found: Vehicles3D, truth: LabelledInstant, mode: str = "correct", **options: float):
    return evaluate([found], LabelTimeline([truth]), RIG, EvaluateConfig(**options), mode)  # type: ignore[arg-type]


box = st.tuples(
    st.floats(-30, 30), st.floats(-30, 30), st.floats(0.5, 2), st.floats(2, 10), st.floats(1, 3), st.floats(1, 4),
    st.floats(-3.1, 3.1),
).map(np.array)  # fmt: skip


@given(box)
def test_law_identical_boxes_are_perfect(b: np.ndarray) -> None:
    metrics = compare(b[None], b[None])
    got = [getattr(metrics, name)[0] for name in METRICS]
    np.testing.assert_allclose(got, [1, 1, 0, 0, 0], atol=1e-9)


@settings(max_examples=60)
@given(box, box)
def test_law_metrics_are_symmetric_and_bounded(a: np.ndarray, b: np.ndarray) -> None:
    one, other = compare(a[None], b[None]), compare(b[None], a[None])
    for name in METRICS:
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-9, err_msg=name)
    assert 0 <= one.iou_3d[0] <= one.bev_iou[0] + 1e-12 <= 1 + 1e-9
    assert 0 <= one.ase[0] < 1
    assert 0 <= one.aoe_deg[0] <= 180


def test_each_metric_by_hand() -> None:
    truth = boxes((0, 0), yaw=0.0)
    moved = truth + [[1.0, 0.9, 0, 0, 0, 0, 0]]
    metrics = compare(moved, truth)
    overlap = 3.5 * 0.9
    assert metrics.bev_iou[0] == pytest.approx(overlap / (2 * 4.5 * 1.8 - overlap))
    assert metrics.ate_m[0] == pytest.approx(np.hypot(1.0, 0.9))
    smaller = truth * [[1, 1, 1, 0.5, 1, 1, 1]]
    assert scale_error(smaller, truth)[0] == pytest.approx(0.5)
    turned = truth + [[0, 0, 0, 0, 0, 0, np.pi + 0.1]]
    assert compare(turned, truth).aoe_deg[0] == pytest.approx(180 - np.degrees(0.1))


def test_scale_error_ignores_position_and_rotation() -> None:
    truth = boxes((0, 0))
    far = boxes((9, -7), yaw=-2.0) * [[1, 1, 1, 0.9, 1.1, 1, 1]]
    near = truth * [[1, 1, 1, 0.9, 1.1, 1, 1]]
    assert scale_error(far, truth)[0] == pytest.approx(scale_error(near, truth)[0])


def test_paper_quirk_a_perfect_box_one_and_a_half_metres_high_scores_three_quarters() -> None:
    truth = boxes((0, 0))
    assert compare_as_published(truth, truth).iou_3d[0] == pytest.approx(0.75)
    assert compare_as_published(truth, truth).bev_iou[0] == pytest.approx(1)


def test_paper_quirk_translation_error_has_no_height() -> None:
    truth = boxes((0, 0))
    lifted = truth + [[0.3, 0.4, 2.0, 0, 0, 0, 0]]
    assert compare_as_published(lifted, truth).ate_m[0] == pytest.approx(0.5)
    assert compare(lifted, truth).ate_m[0] == pytest.approx(np.hypot(0.5, 2.0))


def test_paper_quirk_yaw_aliases_are_left_out_and_their_share_reported() -> None:
    truth = boxes((-5, -5), (-5, 5), (12, 7), (12, -7))
    found = truth.copy()
    found[:, 6] += np.radians([10, 149, 151, 180])
    published = run(detected(found), labelled(truth, [1] * 4), "paper_compat")
    assert np.isnan(published.metrics.aoe_deg).sum() == 2
    assert published.alias_share == 0.5 == alias_share(found, truth)
    assert summarise(published).aoe_deg.mean == pytest.approx((10 + 149) / 2)
    assert summarise(run(detected(found), labelled(truth, [1] * 4))).aoe_deg.mean == pytest.approx(122.5)


def test_paper_quirk_low_scores_and_long_vehicles_are_dropped() -> None:
    found = boxes((0, 0), (0, 5), (0, 10))
    found[1, 3] = 6.5
    np.testing.assert_array_equal(paper_filter(found, np.array([0.4, 0.9, 0.39])), [0])


def test_paper_quirk_misses_and_false_positives_are_not_counted() -> None:
    truth = boxes((0, 0), (5, 5))
    found = np.concatenate([boxes((0.1, 0)), boxes((-5, -8))])
    published = run(detected(found), labelled(truth, [1, 1]), "paper_compat")
    assert len(published.matched.vehicle_ids) == 1
    assert len(published.missed.vehicle_ids) == published.false_positives == 0
    figures = summarise(published).model_dump()
    assert figures["recall"] == {"mean": None, "sd": None} and figures["missed"] is figures["precision"] is None
    assert figures["matched"] == 1


def test_paper_quirk_only_matches_in_the_image_count() -> None:
    truth = boxes((0, 0))
    behind = truth + [[3.0, 0, 0, 0, 0, 0, 0]]
    assert len(match_in_image(truth, np.array([True]), behind, CAMERA).labels) == 0
    assert len(match_in_image(truth, np.array([True]), truth + 0.05, CAMERA).labels) == 1
    assert len(match_in_image(truth, np.array([False]), truth, CAMERA).labels) == 0


def test_matching_is_optimal_not_greedy() -> None:
    # Greedy by distance would pair label 1 with detection 0 (1.0 m) and leave label 0 alone.
    labels = boxes((0, 0), (3, 0))
    found = boxes((2, 0), (5, 0))
    match = match_on_ground(labels, np.ones(2, bool), found, 4.0)
    assert sorted(zip(match.labels, match.detections, strict=True)) == [(0, 0), (1, 1)]


def test_assign_pairs_nothing_at_the_limit_or_beyond() -> None:
    rows, columns = assign(np.array([[1.0, 2.0], [1.5, 9.0]]), 2.0)
    assert (rows.tolist(), columns.tolist()) == ([0], [0])
    assert [len(found) for found in assign(np.empty((0, 3)), 2.0)] == [0, 0]


def test_a_missed_vehicle_is_not_credited_with_its_neighbours_detection() -> None:
    labels = boxes((0, 0), (0, 3.4))  # two lanes
    match = match_on_ground(labels, np.ones(2, bool), boxes((0, 0.05), (0, -3.5)), 4.0)
    assert (match.labels.tolist(), match.detections.tolist()) == ([0], [0])
    assert (match.missed.tolist(), match.false_positives.tolist()) == ([1], [1])


def test_a_detection_of_an_uncounted_label_is_neither_hit_nor_false_positive() -> None:
    truth = boxes((0, 0), (10, 0), (20, 8))
    counts = np.array([True, False, False])
    match = match_on_ground(truth, counts, boxes((0.5, 0), (10.5, 0), (9.5, 0.3), (-9, 0)), 4.0)
    assert match.labels.tolist() == [0]
    assert match.detections.tolist() == [0]
    assert match.missed.tolist() == []
    assert match.false_positives.tolist() == [3]


def test_the_detection_of_a_hidden_vehicle_is_not_credited_to_its_missed_neighbour() -> None:
    truth = boxes((0, 0), (3.5, 0))
    match = match_on_ground(truth, np.array([True, False]), boxes((3.5, 0.1)), 4.0)
    # the one detection goes to the nearer label, which does not count
    assert match.labels.tolist() == []
    assert match.missed.tolist() == [0]
    assert match.false_positives.tolist() == []


def test_hidden_and_far_labels_do_not_count() -> None:
    truth = boxes((0, 0), (5, 3), (40, 0))
    evaluation = run(detected(np.empty((0, 7))), labelled(truth, [1.0, 0.3, 1.0]), max_range_m=50)
    assert evaluation.missed.vehicle_ids.tolist() == [0]
    assert evaluation.missed.distance_m.tolist() == [25.0]


def test_far_detections_are_not_held_against_a_detector() -> None:
    evaluation = run(detected(boxes((60, 0), (5, 5))), labelled(boxes((0, 0)), [1.0]))
    assert evaluation.false_positives == 1


def test_a_label_without_this_camera_is_not_seen_by_it() -> None:
    instant = LabelledInstant(Vehicles3D.of(0, boxes((0, 0))), {"b": np.array([1.0])})
    evaluation = run(detected(boxes((0, 0))), instant)
    assert len(evaluation.matched.vehicle_ids) == len(evaluation.missed.vehicle_ids) == 0
    assert evaluation.false_positives == 0


def test_summary_counts_misses_as_zero_and_gives_recall_over_vehicles() -> None:
    truth = boxes((0, 0), (8, 8))
    labels = [labelled(truth, [1, 1], time_ns=k * 10**9, ids=[7, 9]) for k in range(4)]
    found = [detected(truth if k == 0 else truth[:1], time_ns=k * 10**9) for k in range(4)]
    figures = summarise(evaluate(found, LabelTimeline(labels), RIG, EvaluateConfig())).model_dump()
    assert (figures["matched"], figures["missed"], figures["false_positives"]) == (5, 3, 0)
    assert figures["recall"]["mean"] == pytest.approx(5 / 8)
    assert figures["recall"]["sd"] == pytest.approx(np.std([1.0, 0.25], ddof=1))
    assert figures["bev_iou"] == {"mean": pytest.approx(1), "sd": pytest.approx(0, abs=1e-9)}
    assert figures["bev_iou_misses_zero"]["mean"] == pytest.approx(5 / 8)
    assert figures["precision"] == 1


def test_nothing_matched_gives_none_not_nan() -> None:
    figures = summarise(run(detected(np.empty((0, 7))), labelled(boxes((0, 0)), [1.0]))).model_dump()
    assert figures["bev_iou"] == {"mean": None, "sd": None}
    assert figures["recall"]["mean"] == 0
    assert figures["precision"] is None


def test_bins_hold_every_sighting_once() -> None:
    truth = boxes((-10, 0), (0, 0), (8, 8), (15, -5))
    evaluation = run(detected(truth[:3] + 0.1), labelled(truth, [0.31, 0.5, 0.95, 1.0]), min_visibility=0.3)
    for bins in (by_visibility(evaluation), by_distance(evaluation), by_elevation(evaluation), by_class(evaluation)):
        assert sum(b.matched for b in bins) == 3
        assert sum(b.missed for b in bins) == 1
    assert [b.low for b in by_visibility(evaluation)] == [0.3, 0.9]


def test_elevation_is_the_angle_between_the_ground_and_the_ray_to_the_vehicle() -> None:
    # 7.25 m above the vehicles' middles, at 10, 20 and 41.1 m
    truth = boxes((-15, 0), (-5, 0), (16.1, 0))
    evaluation = run(detected(truth), labelled(truth, [1] * 3))
    np.testing.assert_allclose(evaluation.matched.elevation_deg, np.degrees(np.arctan2(7.25, [10, 20, 41.1])))
    assert [(b.low, b.high) for b in by_elevation(evaluation)] == [(10, 20), (30, None)]
    near = run(detected(truth[2:]), labelled(truth[2:], [1.0]), max_range_m=60)
    assert [(b.low, b.high) for b in by_elevation(near)] == [(10, 20)]
    far = boxes((24, 0))
    assert by_elevation(run(detected(far), labelled(far, [1.0])))[0].low is None


def test_classes_are_the_true_ones() -> None:
    truth = boxes((0, 0), (8, 8), (-9, 4))
    vehicles = Vehicles3D.of(0, truth, classes=np.array([3, 0, 0]), ids=np.arange(3))
    found = by_class(run(detected(truth[:2]), LabelledInstant(vehicles, {"a": np.ones(3)})))
    assert [(b.road_user_class, b.matched, b.missed, b.recall) for b in found] == [
        ("car", 1, 1, 0.5),
        ("bus", 1, 0, 1),
    ]


def test_errors_and_stated_standard_deviations_are_those_of_the_matches() -> None:
    truth = boxes((0, 0), (8, 8), yaw=3.1)
    found = truth[::-1] + [[0.1, 0, 0, 0, 0, 0, 0.2]]
    sd = np.array([[0.2] * 7, [0.3] * 7])
    vehicles = Vehicles3D.of(0, found, sd=sd, camera_id="a")
    evaluation = run(vehicles, labelled(truth, [1, 1]))
    np.testing.assert_allclose(evaluation.errors, [[0.1, 0, 0, 0, 0, 0, 0.2]] * 2, atol=1e-12)
    assert evaluation.matched.vehicle_ids.tolist() == [0, 1]
    np.testing.assert_allclose(evaluation.sd[:, 0], [0.3, 0.2])


def test_sightings_without_an_id_are_different_vehicles() -> None:
    truth = boxes((0, 0), (8, 8))
    evaluation = run(detected(truth[:1]), labelled(truth, [1, 1], ids=[-1, -1]))
    ids = [*evaluation.matched.vehicle_ids, *evaluation.missed.vehicle_ids]
    assert len(set(ids)) == 2


def test_a_label_without_an_id_is_the_same_vehicle_for_every_detector() -> None:
    truth = boxes((0, 0), (8, 8))
    labels = labelled(truth, [1, 1], ids=[-1, -1])
    first = run(detected(truth[:1]), labels).matched.vehicle_ids.tolist()
    second = run(detected(truth[1:]), labels).matched.vehicle_ids.tolist()
    both = run(detected(truth), labels).matched.vehicle_ids.tolist()
    assert sorted(first + second) == sorted(both)


def test_a_car_beside_somebody_on_foot_is_not_their_detection() -> None:
    truth = boxes((0, 0), (8, 8))
    people = np.full(2, RoadUserClass.PEDESTRIAN.number)
    labels = LabelledInstant(Vehicles3D.of(0, truth, classes=people, ids=np.arange(2)), {"a": np.ones(2)})
    car = Vehicles3D.of(0, truth[:1], camera_id="a")
    seen = run(car, labels)
    assert len(seen.matched.classes) == 0 and seen.false_positives == 1
    assert seen.missed.classes.tolist() == people.tolist()


def test_a_network_is_not_asked_for_what_it_does_not_know() -> None:
    truth = boxes((0, 0), (8, 8))
    classes = np.array([RoadUserClass.CAR.number, RoadUserClass.PEDESTRIAN.number])
    labels = LabelledInstant(Vehicles3D.of(0, truth, classes=classes, ids=np.arange(2)), {"a": np.ones(2)})
    known = evaluate(
        [Vehicles3D.of(0, truth[:1], camera_id="a")],
        LabelTimeline([labels]),
        {"a": CAMERA},
        EvaluateConfig(),
        classes=[RoadUserClass.CAR, RoadUserClass.VAN],
    )
    assert known.matched.classes.tolist() == [RoadUserClass.CAR.number]
    assert len(known.missed.classes) == known.false_positives == 0


@pytest.mark.parametrize("mode", ["correct", "paper_compat"])
def test_where_nobody_looked_closely_nothing_is_missed_and_nothing_is_wrong(mode: str) -> None:
    """Two labels and three detections; one of each lies in the region."""
    truth = replace(
        labelled(boxes((0, 0), (10, 5)), [1.0, 1.0]),
        do_not_care=(np.array([[8.0, 3.0], [20.0, 3.0], [20.0, 9.0], [8.0, 9.0]]),),
    )
    found = detected(boxes((0.1, 0), (16, 6), (0, -12)))
    got = run(found, truth, mode)
    assert (len(got.metrics.ate_m), len(got.missed.visibility)) == (1, 0)
    assert got.false_positives == (1 if mode == "correct" else 0)
    without = run(found, replace(truth, do_not_care=()), "correct")
    assert (len(without.missed.visibility), without.false_positives) == (1, 2)
