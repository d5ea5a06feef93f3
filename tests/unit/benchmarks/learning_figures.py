"""Options and figures of a run, as the benchmarks of learning have them."""

from __future__ import annotations

import argparse
from typing import Any


def arguments(**changed: Any) -> argparse.Namespace:
    usual = {"sites": [11, 31], "seeds": [0, 1], "methods": ["baseline", "lifted"], "steps": 5, "seconds": 9.0}
    return argparse.Namespace(
        **{**usual, "density": 1.0, "width_px": 640, "shares": [0.5, 1.0], "network": None, **changed}
    )


def figures(bev: float, difference: float = 0.1) -> dict[str, Any]:
    spread = {"mean": bev, "sd": 0.1}
    test = {"difference": difference, "p_bootstrap": 0.001}
    names = ("iou_3d", "ate_m", "ase", "aoe_deg", "recall", "bev_iou_misses_zero")
    parts = [
        {"low": 0.0, "high": 10.0, "bev_iou": spread, "ate_m": spread, "recall": 0.9},
        {"low": 50.0, "high": None, "bev_iou": spread, "ate_m": spread, "recall": 0.1},
    ]
    return {
        "chosen_on": False,
        "decode": "plane",
        "bev_iou": spread,
        **dict.fromkeys(names, spread),
        "precision": 0.9,
        "false_positives": 7,
        "significance": {"bev_iou": test},
        "by_distance": parts,
    }
