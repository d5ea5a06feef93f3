"""The amount of footage that jobs learned from, and what came of it (Howe et al. 2021, figure 4)."""

from __future__ import annotations

from collections.abc import Iterable

from wibam_core.adapters.results import JobResults
from wibam_core.artifacts import catalogue
from wibam_core.documents.amounts import BeforeAfter, JobAmount
from wibam_core.documents.metrics import Consistency, DetectorFigures, Metrics
from wibam_core.documents.statistics import DatasetStatistics
from wibam_core.jobs.records import Job


def amounts(results: JobResults, jobs: Iterable[Job]) -> list[JobAmount]:
    """Of those jobs that have been evaluated, the smallest amount first."""
    found = [
        _amount(job, results.read(job, catalogue.METRICS), results.read(job, catalogue.DATASET_STATISTICS))
        for job in jobs
        if results.has(job, catalogue.METRICS) and results.has(job, catalogue.DATASET_STATISTICS)
    ]
    return sorted(found, key=lambda one: (one.train_s, one.job_id))


def _amount(job: Job, metrics: Metrics, statistics: DatasetStatistics) -> JobAmount:
    train, test = statistics.subsets["train"], metrics.labelled_instants
    before, after = metrics.baseline, metrics.finetuned
    return JobAmount(
        job_id=job.id,
        name=job.name,
        train_s=train.seconds,
        train_vehicles=train.tracks,
        test_from_s=test.test_from_s,
        test_to_s=test.test_to_s,
        labels=metrics.labels,
        labelled_instants=test.in_test_part,
        bev_iou_misses_zero=BeforeAfter(baseline=_misses_zero(before), finetuned=_misses_zero(after)),
        recall=BeforeAfter(baseline=_recall(before), finetuned=_recall(after)),
        other_views=BeforeAfter(
            baseline=_other_views(metrics.self_consistency.get("baseline")),
            finetuned=_other_views(metrics.self_consistency.get("finetuned")),
        ),
    )


def _misses_zero(figures: DetectorFigures | None) -> float | None:
    return None if figures is None else figures.bev_iou_misses_zero.mean


def _recall(figures: DetectorFigures | None) -> float | None:
    return None if figures is None else figures.recall.mean


def _other_views(consistency: Consistency | None) -> float | None:
    return None if consistency is None else consistency.other_views.mean
