"""Find the boxes of one vehicle in all cameras, and follow it over time."""

from __future__ import annotations

from wibam_core.artifacts.catalogue import ANNOTATIONS, ASSOCIATION_STATISTICS, DETECTIONS, RIG, SEARCHED_INSTANTS
from wibam_core.association.associate import associate, association_statistics
from wibam_core.association.scale import size_cautions
from wibam_core.config import AssociateConfig
from wibam_core.detection.instants import annotated
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: AssociateConfig) -> Summary:
    """Write `ANNOTATIONS` and `ASSOCIATION_STATISTICS`.

    Raises:
        CalibrationError: road users look impossibly large or small in a camera.
        NoVehicles: no box lies on the ground within range.
        NoMultiViewVehicles: no two boxes of different cameras meet on the ground.
    """
    searched, detected = context.read(SEARCHED_INSTANTS), context.read(DETECTIONS)
    rig, seen = context.read(RIG), annotated(searched, detected)
    context.warn(*size_cautions(seen, rig))
    instants = associate(seen, rig, config, context.progress)
    statistics = association_statistics(instants)
    context.write(ANNOTATIONS, instants)
    context.write(ASSOCIATION_STATISTICS, statistics)
    return statistics.model_dump()
