"""Disturbances are as large as they say, and correlations are of the right pairs."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks import robustness, self_consistency
from benchmarks.learning_rows import write_rows
from benchmarks.learning_sites import Site, consistency
from tests.builders import corner_rig, site_of
from tests.multiview import Scene, crossing
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.config import AssociateConfig, DatasetConfig, FinetuneConfig, LiftConfig
from wibam_core.documents.refinement import Refinement
from wibam_core.documents.split import SUBSETS, Split
from wibam_core.evaluation.instants import exposure_times
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.lifting.instants import thinned, within_split
from wibam_core.scene import AnnotatedInstant, Detections2D, FrameSet, LabelledInstant, Vehicles3D
from wibam_core.stages import associate, dataset, lift

RIG = corner_rig(3)
#: A split of a few seconds.
SHORT = DatasetConfig(rate_hz=4.0, train_share=0.6, val_share=0.2, gap_s=0.3)


def test_cameras_are_turned_by_the_angle_about_their_centres() -> None:
    wrong = robustness.with_wrong_poses(RIG, 0.3, np.random.default_rng(0))
    axes = []
    for camera_id, camera in RIG.items():
        turn = camera.T_world_cam.rotation.T @ wrong[camera_id].T_world_cam.rotation
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(0.3, rel=1e-3)
        np.testing.assert_allclose(wrong[camera_id].centre_m, camera.centre_m, atol=1e-12)
        axes.append(turn[0, 1])
    assert len(set(axes)) == 3


def test_a_wrong_clock_is_wrong_by_the_same_at_every_instant_and_the_reference_is_right() -> None:
    def seen(time_ns: int, camera_id: str) -> Detections2D:
        return Detections2D(camera_id, time_ns, np.array([[0.0, 0, 9, 9]]), np.ones(1), np.zeros(1, int))

    instants = [AnnotatedInstant(t, {c: seen(t, c) for c in RIG}) for t in (0, 80_000_000)]
    wrong = robustness.with_wrong_clocks(instants, RIG, 20.0, np.random.default_rng(0))
    assert [instant.time_ns for instant in wrong] == [0, 80_000_000]
    late = {c: {w.detections[c].frame_time_ns - w.time_ns for w in wrong} for c in RIG}
    assert late.pop(RIG.reference_id) == {0}
    assert all(len(of) == 1 and 0 < abs(next(iter(of))) < 100_000_000 for of in late.values())


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> StageFolders:
    """What the stages from detection to the fits leave of a small scene."""
    job, scene = StageFolders(tmp_path_factory.mktemp("job")), crossing()
    job.give(catalogue.RIG, scene.rig)
    job.give(catalogue.REFINEMENT, Refinement(method="none", taken=False, reason="it is exact"))
    job.give_detected(scene.unassociated)
    site = site_of(scene.rig)
    associate.run(job.context("associate", site), AssociateConfig())
    dataset.run(job.context("dataset", site), SHORT)
    lift.run(job.context("lift", site), LiftConfig())
    return job


def test_nothing_disturbed_gives_what_a_job_computes(job: StageFolders, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robustness, "DatasetConfig", lambda: SHORT)
    fits = job.read(catalogue.FITS)
    site = Site(11, None, None, job.reader, job.read(catalogue.RIG), None, [], [], None, None)  # type: ignore[arg-type]
    again = robustness.disturbed(site, "pose_deg", 0.0, 0).lifts
    assert [v.time_ns for v in again] == [v.time_ns for v in fits] and sum(map(len, fits)) > 50
    for ours, theirs in zip(again, fits, strict=True):
        assert ours.ids.tolist() == theirs.ids.tolist()
        np.testing.assert_allclose(ours.boxes, theirs.boxes, atol=1e-3)


def test_the_fits_are_thinned_to_the_split_and_a_period() -> None:
    times = [k * 40_000_000 for k in range(20)]
    split = Split(
        times_ns={"train": (0, 280_000_000), "val": (), "test": (600_000_000,)},
        left_out_tracks=dict.fromkeys(SUBSETS, frozenset()),
    )
    kept = [instant.time_ns for instant in thinned([AnnotatedInstant(t, {}) for t in times], split, 6.25)]
    assert kept == [k * 40_000_000 for k in (0, 4, 7, 11, 15, 19)]


def test_labels_are_without_the_vehicles_that_another_part_keeps() -> None:
    split = Split(
        times_ns={"train": (0,), "val": (), "test": (9,)},
        left_out_tracks={"train": frozenset({5}), "val": frozenset(), "test": frozenset()},
    )
    fits = [Vehicles3D.of(t, np.ones((2, 7)), np.zeros(2, int), np.array([4, 5]), np.ones(2)) for t in (0, 3, 9)]
    labels = within_split(fits, split)
    assert {v.time_ns: v.ids.tolist() for v in labels} == {0: [4], 9: [4, 5]}


def test_every_frame_has_its_own_time_of_exposure() -> None:
    instants = [FrameSet(0, {"a": 0, "b": 7}, {}), FrameSet(80, {"a": 81}, {})]
    assert exposure_times(instants) == {(0, "a"): 0, (0, "b"): 7, (80, "a"): 81}


def disturbed_rows() -> list[dict[str, Any]]:
    names = ("ate_m", "bev_iou", "aoe_deg")
    return [
        {
            "run": {"site": 1, "kind": kind, "amount": amount, "draw": draw},
            **{name: {"mean": 0.2 + amount + 0.1 * draw} for name in names},
            "matched": 900,
        }
        for kind in robustness.KINDS
        for amount in (0.0, 0.3)
        for draw in range(2 if amount else 1)
    ]


def test_draws_have_a_mean_and_a_spread(tmp_path: Path) -> None:
    mean, sd, count = robustness.spread_of(disturbed_rows(), "pose_deg", 0.3, "ate_m")
    assert (mean, sd, count) == (pytest.approx(0.55), pytest.approx(0.1 / np.sqrt(2)), 2)
    text = robustness.document(disturbed_rows(), "command")
    assert "| 0.3 | 2 | 0.55 ± 0.07 |" in text and "| 0 | 1 | 0.20 |" in text
    assert "(`benchmarks/looks.json`)" in text
    on_chosen = [{**row, "run": {**row["run"], "site": 11}} for row in disturbed_rows()]
    assert "so that its figures flatter: 11." in robustness.document(on_chosen, "command")
    robustness.save(robustness.curves_figure(disturbed_rows()), tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 5000


def networks() -> list[dict[str, Any]]:
    """On each of two sites better networks agree more, and the sites differ the other way round."""
    rows = []
    for site in (1, 2):
        for quality in (0.3, 0.5, 0.8):
            vehicles = [
                {"other_views": quality + k / 10, "roughness_m": 1 - k / 10, "bev_iou": k / 10, "ate_m": -(k**3)}
                for k in range(4)
            ]
            figures = {"other_views": quality - site, "roughness_m": 1 - quality, "bev_iou": quality + site}
            rows.append(
                {
                    "run": {"site": site, "method": f"q{quality}"},
                    **figures,
                    "ate_m": 1 - quality,
                    "bev_iou_misses_zero": None,
                    "vehicles": vehicles,
                }
            )
    return rows


def test_correlations_over_all_and_within_sites_and_networks() -> None:
    rows = networks()
    everywhere = self_consistency.among_networks(rows, "other_views", "bev_iou")
    assert everywhere.n == 6 and everywhere.pearson < 0
    within = self_consistency.within_groups(self_consistency.same_site(rows), "other_views", "bev_iou")
    assert (within.pearson, within.spearman, within.n) == (pytest.approx(1), pytest.approx(1), 2)
    vehicles = self_consistency.within_groups([row["vehicles"] for row in rows], "other_views", "ate_m")
    assert vehicles.spearman == pytest.approx(-1) and -1 < vehicles.pearson < -0.8
    unknown = self_consistency.among_networks(rows, "other_views", "bev_iou_misses_zero")
    assert np.isnan(unknown.spearman) and unknown.n == 0


def test_the_consistency_document_and_figure(tmp_path: Path) -> None:
    text = self_consistency.document(networks(), "command")
    assert "| IoU in other views | BEV IoU |" in text and "1.00 / 1.00 (2)" in text
    assert "(`benchmarks/looks.json`)" in text
    self_consistency.save(self_consistency.scatter_figure(networks()), tmp_path / "scatter.png")
    assert (tmp_path / "scatter.png").stat().st_size > 5000


def found_at(scene: Scene, off_m: float) -> list[Vehicles3D]:
    """What a network finds that is always as wrong: every camera sees all that is there, at an instant."""
    return [
        replace(true, boxes=true.boxes + [off_m, 0, 0, 0, 0, 0, 0], camera_id=camera_id)
        for true in scene.truth
        for camera_id in scene.rig
    ]


def test_vehicles_have_both_sides() -> None:
    scene = crossing(offset_ns=0)
    times = tuple(instant.time_ns for instant in scene.instants)
    frames: Any = SimpleNamespace(frame_sets=[FrameSet(t, dict.fromkeys(scene.rig, t), {}) for t in times])
    labels = LabelTimeline([LabelledInstant(true, {}) for true in scene.truth])
    split = Split(times_ns={"train": (), "val": (), "test": times}, left_out_tracks=dict.fromkeys(SUBSETS, frozenset()))
    site = Site(1, None, None, {}, scene.rig, frames, scene.instants, [], split, labels)  # type: ignore[arg-type]
    near, far = (consistency(site, found_at(scene, off_m)) for off_m in (0.2, 1.0))
    assert near["other_views"]["mean"] > far["other_views"]["mean"] + 0.1
    assert len(near["vehicles"]) > 5
    for one in near["vehicles"]:
        assert one["ate_m"] == pytest.approx(0.2) and 0.7 < one["bev_iou"] < 1
        assert one["other_views"] > 0.5 and one["roughness_m"] < 0.3 and one["boxes"] >= 4


def test_networks_of_other_benchmarks_are_compared_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = {"seconds": 90.0, "density": 1.2, "width_px": 640}
    measured = [
        {
            "run": {"site": 7, "seed": 0, "method": f"lifted_{k}", **recorded},
            **{name: {"mean": k / 10} for name in ("bev_iou", "ate_m", "bev_iou_misses_zero")},
            "consistency": {"other_views": {"mean": 0.5 + k / 20}, "roughness_m": {"mean": 0.1}, "vehicles": []},
        }
        for k in (3, 5, 8)
    ]
    others = tmp_path / "ablation.json"
    write_rows(others, [*measured, {"run": {"site": 7, "method": "labels"}, "bev_iou": {"mean": 0.9}}])
    monkeypatch.setattr(sys, "argv", ["x", "--networks", "--with", str(others), "--out", str(tmp_path)])
    self_consistency.main()
    text = (tmp_path / "self-consistency.md").read_text()
    assert "| IoU in other views | BEV IoU | 1.00 / 1.00 (3) | 1.00 / 1.00 (1) |" in text
    assert "| 7 | lifted_8 | 0.900 | 0.100 | 0.800 |" in text and "labels" not in text
    assert f"    python -m benchmarks.self_consistency --networks --with {others}\n" in text
    assert (tmp_path / "self-consistency.png").is_file()


def test_recipes_place_boxes_as_jobs_do() -> None:
    of = {name: FinetuneConfig(**recipe.options) for name, recipe in self_consistency.RECIPES.items() if recipe.steps}
    assert {config.decode for name, config in of.items() if name.startswith("lifted")} == {"refined"}
    assert of["paper_200"].decode == "plane" and of["lifted_20"].steps == 20
    assert self_consistency.Recipe(9, decode="depth").options == {"steps": 9, "method": "lifted", "decode": "depth"}
