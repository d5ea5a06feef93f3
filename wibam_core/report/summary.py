"""The result of a job in one small document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from wibam_core.documents.metrics import DetectorFigures, Metrics
from wibam_core.documents.summary import HeadlineFigures, JobSummary
from wibam_core.documents.warnings import StageWarning


def summary(
    metrics: Metrics,
    seconds: Mapping[str, float],
    warnings: Sequence[StageWarning],
    tracks: int,
    conflicts: int,
    paths: Mapping[str, Path],
) -> JobSummary:
    """The figures of a job.

    Args:
        metrics: of both networks.
        seconds: running time by stage.
        warnings: of all stages.
        tracks: how many.
        conflicts: how many.
        paths: "weights", "tracks" (Parquet) and "report".
    """
    return JobSummary(
        baseline=_figures(metrics.baseline),
        finetuned=_figures(metrics.finetuned),
        self_consistency={name: value.other_views for name, value in metrics.self_consistency.items()},
        seconds={stage: round(float(value), 3) for stage, value in seconds.items()},
        warnings=tuple(warnings),
        tracks=tracks,
        conflicts=conflicts,
        paths={name: str(path) for name, path in paths.items()},
    )


def _figures(figures: DetectorFigures | None) -> HeadlineFigures | None:
    if figures is None:
        return None
    same = set(HeadlineFigures.model_fields) - {"missed"}
    return HeadlineFigures(**{name: getattr(figures, name) for name in same}, missed=figures.missed or 0)
