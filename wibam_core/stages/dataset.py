"""Split the annotated instants in time."""

from __future__ import annotations

from wibam_core.artifacts.catalogue import ANNOTATIONS, DATASET_STATISTICS, RIG, SPLIT
from wibam_core.config import DatasetConfig
from wibam_core.dataset.split import split_in_time
from wibam_core.dataset.statistics import dataset_statistics
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: DatasetConfig) -> Summary:
    """Write `SPLIT` and `DATASET_STATISTICS`.

    Raises:
        TooFewInstants: the recordings are too short for three subsets.
    """
    instants = context.read(ANNOTATIONS)
    split = split_in_time(instants, config)
    statistics = dataset_statistics(instants, context.read(RIG), split)
    context.write(SPLIT, split)
    context.write(DATASET_STATISTICS, statistics)
    context.progress(1.0, "split")
    return statistics.model_dump(include={"subsets", "by_views"})
