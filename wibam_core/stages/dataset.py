"""Split the annotated instants in time."""

from __future__ import annotations

import json

from wibam_core.config import DatasetConfig
from wibam_core.dataset.split import split_in_time
from wibam_core.dataset.statistics import dataset_statistics
from wibam_core.formats.annotations import read_annotations
from wibam_core.formats.rig import read_rig
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: DatasetConfig) -> Summary:
    """Write ``split.json`` and ``statistics.json``.

    Raises:
        TooFewInstants: the recordings are too short for three subsets.
    """
    rig = read_rig(context.upstream["calibrate"] / "rig.json")
    instants = read_annotations(context.upstream["associate"] / "annotations.parquet")
    split = split_in_time(instants, config)
    statistics = dataset_statistics(instants, rig, split)
    (context.output / "split.json").write_text(json.dumps(split.to_json()), encoding="utf-8")
    (context.output / "statistics.json").write_text(json.dumps(statistics, indent=1), encoding="utf-8")
    context.progress(1.0, "split")
    return {"subsets": statistics["subsets"], "by_views": statistics["by_views"]}
