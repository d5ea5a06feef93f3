"""Find the boxes of one vehicle in all cameras, and follow it over time."""

from __future__ import annotations

import numpy as np

from wibam_core.artifacts.catalogue import (
    ANNOTATIONS,
    ASSOCIATION_STATISTICS,
    REFINEMENT,
    RIG,
    ROUND_DETECTIONS,
    SEARCHED_INSTANTS,
)
from wibam_core.association.agreement import agreement_cautions
from wibam_core.association.associate import associate, association_statistics
from wibam_core.association.linking import linked_over_time
from wibam_core.association.published import agreement_of, clustered_as_published
from wibam_core.association.scale import size_cautions
from wibam_core.config import AssociateConfig
from wibam_core.detection.instants import annotated
from wibam_core.progress import part
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: AssociateConfig) -> Summary:
    """Write `ANNOTATIONS` and `ASSOCIATION_STATISTICS`.

    Raises:
        CalibrationError: road users look impossibly large or small in a camera.
        NoVehicles: no box lies on the ground within range.
        NoMultiViewVehicles: no two boxes of different cameras meet on the ground.
    """
    searched, detected = context.read(SEARCHED_INSTANTS), context.read(ROUND_DETECTIONS)
    rig, seen = context.read(RIG), annotated(searched, detected)
    context.warn(*size_cautions(seen, rig), *agreement_cautions(seen, rig))
    poses = {name: np.array(matrix) for name, matrix in context.read(REFINEMENT).covariances.items()}
    tracked = associate(seen, rig, config, part(context.progress, 0.0, 0.7), poses)
    paper = clustered_as_published(seen, rig, config)
    agreement = agreement_of(tracked, paper)
    following = part(context.progress, 0.7, 1.0)
    instants = tracked if config.method == "tracked" else linked_over_time(paper, rig, config, following)
    statistics = association_statistics(instants)
    statistics = statistics.model_copy(update={"method": config.method, "agreement": agreement})
    context.write(ANNOTATIONS, instants)
    context.write(ASSOCIATION_STATISTICS, statistics)
    return statistics.model_dump()
