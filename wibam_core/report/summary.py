"""The result of a job in one small JSON object: what a script needs to decide whether it went well."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from wibam_core.report.inputs import DetectorFigures, MeanSd, Metrics

#: The published five and recall, in the order of the paper's table with BEV first.
METRIC_NAMES = ("bev_iou", "iou_3d", "ate_m", "ase", "aoe_deg", "recall")


def summary(
    metrics: Mapping[str, Any],
    seconds: Mapping[str, float],
    tracks: int,
    conflicts: int,
    paths: Mapping[str, Path],
) -> dict[str, Any]:
    """The figures of a job, JSON types only.

    Args:
        metrics: the contents of ``metrics.json``.
        seconds: running time by stage.
        tracks: how many.
        conflicts: how many.
        paths: "weights", "tracks" (Parquet) and "report".

    Returns:
        ``baseline`` and ``finetuned``: `METRIC_NAMES` as ``{"mean", "sd"}``, ``matched`` and ``missed``, or None
        without labels; ``self_consistency`` by method; ``seconds``, ``tracks``, ``conflicts`` and ``paths``.
    """
    read = Metrics.model_validate(metrics)
    return {
        "baseline": _figures(read.baseline),
        "finetuned": _figures(read.finetuned),
        "self_consistency": {name: _mean_sd(value.other_views) for name, value in read.self_consistency.items()},
        "seconds": {stage: round(float(value), 3) for stage, value in seconds.items()},
        "tracks": tracks,
        "conflicts": conflicts,
        "paths": {name: str(path) for name, path in paths.items()},
    }


def _figures(figures: DetectorFigures | None) -> dict[str, Any] | None:
    if figures is None:
        return None
    return {
        **{name: _mean_sd(getattr(figures, name)) for name in METRIC_NAMES},
        "matched": figures.matched,
        "missed": figures.missed or 0,
    }


def _mean_sd(value: MeanSd) -> dict[str, float | None]:
    return {"mean": value.mean, "sd": value.sd}
