"""The result of a job in one small document: what a script needs to decide whether it went well."""

from __future__ import annotations

from wibam_core.documents.base import Document, MeanSd
from wibam_core.documents.warnings import StageWarning


class HeadlineFigures(Document):
    """How one network did against labels, in short: see `wibam_core.documents.metrics.DetectorFigures`."""

    bev_iou: MeanSd
    iou_3d: MeanSd
    ate_m: MeanSd
    ase: MeanSd
    aoe_deg: MeanSd
    recall: MeanSd
    matched: int
    missed: int


class JobSummary(Document):
    """A job in short."""

    baseline: HeadlineFigures | None
    """Null without labels."""
    finetuned: HeadlineFigures | None
    self_consistency: dict[str, MeanSd]
    """By network: IoU of its boxes in the views that they were not made in."""
    seconds: dict[str, float]
    """Running time by stage."""
    warnings: tuple[StageWarning, ...]
    tracks: int
    conflicts: int
    paths: dict[str, str]
    """"weights", "tracks" (Parquet) and "report"."""
