from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from tests.builders import corner_rig
from tests.multiview import crossing
from wibam_core.association.associate import associate
from wibam_core.association.rays import rig_centre
from wibam_core.config import AssociateConfig, LiftConfig
from wibam_core.geometry.iou import bev_iou_paired
from wibam_core.geometry.se3 import SE3
from wibam_core.lifting.lift import LiftResult, lift, residual_limit
from wibam_core.lifting.sizes import track_sizes
from wibam_core.lifting.trajectory import Tracks
from wibam_core.scene import AnnotatedInstant, CameraRig, Vehicles3D


@lru_cache(maxsize=2)
def annotated(true_ids: bool) -> list[AnnotatedInstant]:
    scene = crossing()
    return scene.instants if true_ids else associate(scene.unassociated, scene.rig, AssociateConfig())


@lru_cache(maxsize=2)
def lifted(true_ids: bool) -> LiftResult:
    return lift(annotated(true_ids), crossing().rig, LiftConfig())


def against_truth(found: list[Vehicles3D], instants: list[AnnotatedInstant]) -> dict[str, np.ndarray]:
    """Of every lifted vehicle within 3 m of a true one: boxes, truth, s.d., confidence and number of views."""
    rows: dict[str, list] = {"box": [], "truth": [], "sd": [], "score": [], "views": []}
    for mine, true, instant in zip(found, crossing().truth, instants, strict=True):
        views = {v.track_id: len(v.views) for v in instant.vehicles}
        for k, track in enumerate(mine.ids.tolist()):
            distance = np.hypot(*(true.boxes[:, :2] - mine.boxes[k, :2]).T)
            if distance.min() < 3:
                rows["box"].append(mine.boxes[k])
                rows["truth"].append(true.boxes[distance.argmin()])
                rows["sd"].append(mine.sd[k])
                rows["score"].append(mine.scores[k])
                rows["views"].append(views[track])
    return {name: np.array(values) for name, values in rows.items()}


def yaw_error(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.abs((a[:, 6] - b[:, 6] + np.pi) % (2 * np.pi) - np.pi))


@pytest.mark.parametrize(
    ("true_ids", "several_views", "bev", "ate_m", "aoe_deg"),
    [(True, True, 0.88, 0.12, 2.5), (False, True, 0.86, 0.15, 3.0), (False, False, 0.75, 0.55, 5.0)],
)
def test_lifts_are_near_the_truth(
    true_ids: bool, several_views: bool, bev: float, ate_m: float, aoe_deg: float
) -> None:
    found = against_truth(lifted(true_ids).vehicles, annotated(true_ids))
    these = (found["views"] > 1) == several_views
    box, truth = found["box"][these], found["truth"][these]
    assert len(box) > 80
    assert bev_iou_paired(box, truth).mean() > bev
    assert np.hypot(*(box - truth)[:, :2].T).mean() < ate_m
    assert yaw_error(box, truth).mean() < aoe_deg
    ratio = np.median(box[:, 3:6] / truth[:, 3:6], axis=0)
    assert np.abs(ratio - 1).max() < 0.07


def test_the_worlds_origin_may_be_far_away() -> None:
    """UTM coordinates are millions of metres, of which a float32 keeps half a metre."""
    shift = np.array([500_000.0, 5_400_000.0])
    rig = CameraRig(
        {
            name: replace(c, T_world_cam=SE3(c.T_world_cam.rotation, c.T_world_cam.translation + [*shift, 0.0]))
            for name, c in crossing().rig.items()
        }
    )
    there = [
        replace(i, vehicles=tuple(replace(v, x_m=v.x_m + shift[0], y_m=v.y_m + shift[1]) for v in i.vehicles))
        for i in annotated(False)
    ]
    for here, far in zip(lifted(False).vehicles, lift(there, rig, LiftConfig()).vehicles, strict=True):
        assert far.ids.tolist() == here.ids.tolist()
        np.testing.assert_allclose(far.boxes[:, :2] - shift, here.boxes[:, :2], atol=0.01)


def test_most_vehicles_are_lifted() -> None:
    scene = crossing()
    seen = sum(len(v.views) >= 2 for i in scene.instants for v in i.vehicles)
    assert sum(len(v) for v in lifted(False).vehicles) > 0.93 * seen


def test_there_is_an_entry_for_every_instant() -> None:
    assert [v.time_ns for v in lifted(True).vehicles] == [i.time_ns for i in crossing().instants]


def test_a_vehicle_has_one_size_and_stands_on_the_ground() -> None:
    sizes: dict[int, list[np.ndarray]] = {}
    for vehicles in lifted(False).vehicles:
        assert np.allclose(vehicles.boxes[:, 2], vehicles.boxes[:, 5] / 2)
        for track, box in zip(vehicles.ids.tolist(), vehicles.boxes, strict=True):
            sizes.setdefault(track, []).append(box[3:6])
    assert -1 not in sizes
    spread = [np.ptp(np.log(s), axis=0).max() for s in sizes.values()]
    assert np.median(spread) < 0.03


def test_the_size_of_a_track_is_told_by_where_its_vehicle_was_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[np.ndarray, np.ndarray]] = []

    def spy(tracks: Tracks, sizes: np.ndarray, *rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        given.append((tracks.rows[:, 0], rest[-1]))
        return track_sizes(tracks, sizes, *rest)

    monkeypatch.setattr("wibam_core.lifting.lift.track_sizes", spy)
    instants = annotated(True)[:10]
    lift(instants, crossing().rig, LiftConfig())
    [(first, places)] = given
    seen = instants[0].vehicles
    there = np.array([(vehicle.x_m, vehicle.y_m) for vehicle in seen]) - rig_centre(crossing().rig)[:2]
    nearest = [np.hypot(*(there - place).T).min() for place in places[first[: len(seen)]]]
    assert np.median(nearest) < 1


def test_standard_deviations_are_of_the_right_size() -> None:
    found = against_truth(lifted(True).vehicles, annotated(True))
    z = (found["box"] - found["truth"])[:, [0, 1, 3, 4, 5]] / found["sd"][:, [0, 1, 3, 4, 5]]
    assert (np.percentile(np.abs(z), 68, axis=0) < 2.5).all()
    assert (np.percentile(np.abs(z), 95, axis=0) > 0.4).all()


def test_confidence_ranks_fits() -> None:
    found = against_truth(lifted(False).vehicles, annotated(False))
    overlap = bev_iou_paired(found["box"], found["truth"])
    low, high = np.quantile(found["score"], [0.2, 0.8])
    assert overlap[found["score"] >= high].mean() > overlap[found["score"] <= low].mean()
    assert ((found["score"] >= 0) & (found["score"] <= 1)).all()


def test_time_offsets_between_cameras_are_allowed_for() -> None:
    """Views up to 30 ms late move a car by up to 0.4 m; told nothing of it, the fit is pulled along."""
    scene = crossing()
    blind = [
        AnnotatedInstant(
            i.time_ns, {c: replace(d, frame_time_ns=i.time_ns) for c, d in i.detections.items()}, i.vehicles
        )
        for i in scene.instants
    ]
    informed = against_truth(lifted(True).vehicles, scene.instants)
    ignored = against_truth(lift(blind, scene.rig, LiftConfig()).vehicles, blind)

    def error(found: dict[str, np.ndarray]) -> float:
        apart = np.hypot(*(found["box"] - found["truth"])[:, :2].T)
        return float(apart[found["views"] > 1].mean())

    assert error(informed) < 0.8 * error(ignored)


def test_what_one_camera_alone_sees_all_the_time_is_lifted_too() -> None:
    scene = crossing()
    alone = [
        replace(
            instant,
            vehicles=tuple(replace(v, views=dict([min(v.views.items())])) for v in instant.vehicles),
        )
        for instant in scene.instants
    ]
    found = against_truth(lift(alone, scene.rig, LiftConfig()).vehicles, alone)
    assert len(found["box"]) > 0.4 * len(against_truth(lifted(True).vehicles, scene.instants)["box"])
    assert (found["views"] == 1).all()
    off = np.hypot(*(found["box"] - found["truth"])[:, :2].T)
    assert off.mean() < 0.6
    assert np.median(np.hypot(*found["sd"][:, :2].T)) > 0.5 * np.median(off), "and says how uncertain it is"
    few = lift(alone[:4], scene.rig, LiftConfig())
    assert few.statistics.fits == 0, "too short to tell anything"
    assert lift(alone[:4], scene.rig, LiftConfig(few_views_sightings=4)).statistics.fits > 0, "unless asked to"
    strict = lift(alone, scene.rig, LiftConfig(few_views_sd_m=0.35))
    assert 0 < strict.statistics.kept < len(found["box"]) / 2
    assert max(np.hypot(*vehicles.sd[:, :2].T).max(initial=0.0) for vehicles in strict.vehicles) <= 0.35


def test_a_residual_limit_leaves_fits_out() -> None:
    scene = crossing()
    strict = lift(scene.instants, scene.rig, LiftConfig(max_residual=0.04, max_usual_residuals=0.0))
    assert strict.statistics.kept == sum(len(v) for v in strict.vehicles)
    assert strict.statistics.kept < lifted(True).statistics.kept


def test_where_all_fits_disagree_with_the_cameras_only_odd_ones_are_left_out() -> None:
    views = np.array([2.0, 3.0, 4.0, 2.0, 3.0, 1.0])
    exact, off = np.array([0.02, 0.03, 0.05, 0.04, 0.3, 0.0]), np.array([0.2, 0.25, 0.3, 0.22, 0.9, 0.0])
    assert residual_limit(exact, views, LiftConfig()) == 0.2
    assert residual_limit(off, views, LiftConfig(max_usual_residuals=2.0)) == pytest.approx(0.5)
    assert residual_limit(off, views, LiftConfig(max_usual_residuals=0.0)) == 0.2
    assert residual_limit(off[5:], views[5:], LiftConfig()) == 0.2


def test_it_is_deterministic() -> None:
    scene = crossing()
    first, second = (lift(scene.instants[:10], scene.rig, LiftConfig()).vehicles for _ in range(2))
    assert all(np.array_equal(a.boxes, b.boxes) for a, b in zip(first, second, strict=True))


def test_nothing_to_lift() -> None:
    result = lift([AnnotatedInstant(5, {})], corner_rig(), LiftConfig())
    assert [len(v) for v in result.vehicles] == [0]
    assert result.statistics.fits == 0


def test_errors_that_last_are_told_from_fresh_ones() -> None:
    scene = crossing()
    rng = np.random.default_rng(0)
    shift = {(c, v.track_id): rng.normal(0, 0.08, 4) for i in scene.instants for v in i.vehicles for c in v.views}
    lasting = []
    for instant in scene.instants:
        detections = dict(instant.detections)
        for camera_id, seen in detections.items():
            boxes = seen.boxes.copy()
            for vehicle in instant.vehicles:
                if camera_id in vehicle.views:
                    row = vehicle.views[camera_id]
                    boxes[row] += shift[camera_id, vehicle.track_id] * np.tile(boxes[row, 2:] - boxes[row, :2], 2)
            boxes[:, 2:] = np.maximum(boxes[:, 2:], boxes[:, :2] + 1)
            detections[camera_id] = replace(seen, boxes=boxes)
        lasting.append(AnnotatedInstant(instant.time_ns, detections, instant.vehicles))
    fresh = lifted(True).statistics
    stale = lift(lasting, scene.rig, LiftConfig()).statistics
    assert stale.edge_persistence > fresh.edge_persistence + 0.2
    assert stale.edge_noise > 1.3 * fresh.edge_noise
