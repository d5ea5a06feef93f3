"""Documents of a job, as its stages write them, for the scenes of the report."""

from __future__ import annotations

from typing import Any

import numpy as np

from wibam_core.evaluation.reliability import reliability

OPTIONS = {"max_range_m": 50.0, "min_visibility": 0.3, "match_distance_m": 4.0, "min_score": 0.3}


def figures_json(
    bev: float, ate: float, recall: float, matched: int, missed: int, false_positives: int
) -> dict[str, Any]:
    """One detector's part of ``metrics.json``."""

    def of(mean: float, sd: float) -> dict[str, float]:
        return {"mean": mean, "sd": sd}

    return {
        "bev_iou": of(bev, 0.15),
        "iou_3d": of(bev - 0.04, 0.14),
        "ate_m": of(ate, 0.8 * ate),
        "ase": of(0.1, 0.05),
        "aoe_deg": of(14 * ate, 15 * ate),
        "matched": matched,
        "missed": missed,
        "false_positives": false_positives,
        "frames": 240,
        "alias_share": 0.02,
        "recall": of(recall, 0.2),
        "precision": matched / (matched + false_positives),
        "bev_iou_misses_zero": of(bev * recall, 0.3),
        "iou_3d_misses_zero": of((bev - 0.04) * recall, 0.3),
    }


def metrics_json(*, labels: bool = True) -> dict[str, Any]:
    """``metrics.json`` of a site where fine-tuning helped."""
    methods = {
        "baseline": figures_json(0.46, 0.95, 0.55, 301, 240, 14),
        "baseline_plane": figures_json(0.38, 1.02, 0.55, 301, 240, 14),
        "baseline_depth": figures_json(0.06, 2.87, 0.44, 241, 300, 60),
        "finetuned": figures_json(0.72, 0.36, 0.94, 512, 33, 21),
    }
    compat_only = ("missed", "false_positives", "recall", "precision", "bev_iou_misses_zero", "iou_3d_misses_zero")
    test = {"z": 20.0, "p_z": 1e-9, "p_bootstrap": 0.001}
    change = {"bev_iou": 0.26, "iou_3d": 0.26, "ate_m": -0.59, "ase": 0.0, "aoe_deg": -8.3}
    bins = [
        {"low": low, "high": high, "matched": 80, "missed": 9, "recall": 0.9 - low / 200}
        | {name: methods["finetuned"][name] for name in change}
        for low, high in ((0.0, 10.0), (10.0, 20.0), (20.0, 30.0), (50.0, None))
    ]
    angles = [
        {**one, "low": low, "high": high} for one, (low, high) in zip(bins, ((None, 10.0), (10.0, 20.0)), strict=False)
    ]
    classes = [{**one, "class": name} for one, name in zip(bins, ("car", "van", "bus"), strict=False)]
    shares = [{**one, "low": low, "high": low + 0.2} for one, low in zip(bins, (0.3, 0.5, 0.7), strict=False)]
    agreement = {
        name: {
            "other_views": {"mean": mean, "sd": 0.2},
            "own_view": {"mean": 0.8, "sd": 0.1},
            "roughness_m": {"mean": 0.31, "sd": 0.2},
            "pairs": 900,
            "found": 0.9 if name == "finetuned" else 0.3,
        }
        for name, mean in (("baseline", 0.42), ("baseline_plane", 0.4), ("baseline_depth", 0.2), ("finetuned", 0.71))
    }
    if not labels:
        breakdowns = ("by_visibility", "by_distance", "by_elevation", "by_class")
        empty = dict.fromkeys((*methods, "paper_compat", "significance", *breakdowns, "reliability"))
        return {
            "options": OPTIONS,
            "labels": "none",
            "not_asked_for": ["motorcycle", "bicycle", "pedestrian"],
            "labelled_instants": {"given": 0, "in_test_part": 0, "test_from_s": 51.2, "test_to_s": 58.8},
            "instants": 60,
            "frames": 240,
            **empty,
            "self_consistency": agreement,
        }
    return {
        "options": OPTIONS,
        "labels": "hand",
        "not_asked_for": ["motorcycle", "bicycle", "pedestrian"],
        "labelled_instants": {"given": 60, "in_test_part": 60, "test_from_s": 51.2, "test_to_s": 58.8},
        "instants": 60,
        "frames": 240,
        **methods,
        "paper_compat": {
            name: {key: value for key, value in one.items() if key not in compat_only} for name, one in methods.items()
        },
        "significance": {
            name: {**test, "difference": value, "low": value - 0.05, "high": value + 0.05}
            for name, value in change.items()
        },
        "by_visibility": {"baseline": shares, "baseline_depth": shares, "finetuned": shares},
        "by_distance": {"baseline": bins, "baseline_depth": bins, "finetuned": bins},
        "by_elevation": {"baseline": angles, "baseline_depth": angles, "finetuned": angles},
        "by_class": {"baseline": classes, "baseline_depth": classes, "finetuned": classes},
        "reliability": {
            name: reliability_json(factor)
            for name, factor in (("baseline", 2.5), ("finetuned_as_learned", 1.8), ("finetuned", 1.0))
        },
        "sd_factors": {"position": 1.83, "z": 1.0, "size": 0.71, "yaw": 1.52},
        "self_consistency": agreement,
    }


def reliability_json(factor: float) -> dict[str, Any]:
    """Figures of standard deviations that are too small by a factor, of 800 boxes."""
    rng = np.random.default_rng(0)
    sd = rng.uniform(0.1, 0.6, (800, 7))
    found = reliability(rng.laplace(0, factor * sd / np.sqrt(2)), sd)
    return {kind: of.model_dump() for kind, of in found.items()}


def conflicts_json() -> dict[str, Any]:
    """``conflicts.json`` with the crossing of tracks 1 and 3."""
    return {
        "thresholds": {"ttc_s": 3.0, "pet_s": 2.0, "min_speed_mps": 1.0, "min_following_deceleration_mps2": 3.0},
        "conflicts": [
            {
                "conflict_id": 0,
                "track_ids": [1, 3],
                "classes": ["car", "van"],
                "type": "crossing",
                "time_ns": 3_000_000_000,
                "x_m": 2.0,
                "y_m": -2.0,
                "speeds_mps": [8.0, 7.0],
                "ttc_s": 1.27,
                "ttc_interval_s": [0.9, 1.8],
                "probability": 0.97,
                "pet_s": None,
                "pet_interval_s": [None, None],
                "deceleration_mps2": 3.4,
                "duration_s": 0.8,
                "heading_difference_deg": 90.0,
                "measures": {"delta_speed_mps": 10.6, "stopping_share": None},
            }
        ],
    }
