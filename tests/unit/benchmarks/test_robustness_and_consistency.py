"""Disturbances are as large as they say, and correlations are of the right pairs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import robustness, self_consistency
from tests.builders import corner_rig
from wibam_core.config import FinetuneConfig
from wibam_core.scene import AnnotatedInstant, Detections2D

RIG = corner_rig(3)


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
                    "run": {"site": site, "network": f"q{quality}"},
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
    self_consistency.save(self_consistency.scatter_figure(networks()), tmp_path / "scatter.png")
    assert (tmp_path / "scatter.png").stat().st_size > 5000


def test_recipes_are_options_that_exist() -> None:
    for recipe in self_consistency.RECIPES.values():
        if recipe.steps:
            FinetuneConfig(steps=recipe.steps, method=recipe.method, decode=recipe.decode)  # type: ignore[arg-type]
