"""Find the boxes of one vehicle in all cameras, and follow it over time."""

from __future__ import annotations

import json

from wibam_core.association.associate import associate, association_statistics
from wibam_core.config import AssociateConfig
from wibam_core.formats.annotations import read_annotations, write_annotations
from wibam_core.formats.rig import read_rig
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: AssociateConfig) -> Summary:
    """Write ``annotations.parquet`` and ``statistics.json``.

    Raises:
        NoVehicles: no box lies on the ground within range.
        NoMultiViewVehicles: no two boxes of different cameras meet on the ground.
    """
    rig = read_rig(context.upstream["calibrate"] / "rig.json")
    detected = read_annotations(context.upstream["detect"] / "detections.parquet")
    instants = associate(detected, rig, config, context.progress)
    statistics = association_statistics(instants)
    write_annotations(context.output / "annotations.parquet", instants)
    (context.output / "statistics.json").write_text(json.dumps(statistics, indent=1), encoding="utf-8")
    return statistics
