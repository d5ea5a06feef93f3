"""Refine the calibration by what several cameras see of the traffic."""

from __future__ import annotations

from wibam_core.artifacts.catalogue import (
    CALIBRATED_RIG,
    DETECTIONS,
    REFINEMENT,
    RESIDUALS,
    RIG,
    SEARCHED_INSTANTS,
)
from wibam_core.config import RefineConfig
from wibam_core.detection.instants import annotated
from wibam_core.refinement.unchanged import unchanged
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: RefineConfig) -> Summary:
    """Write `RIG` and `REFINEMENT`."""
    rig, residuals = context.read(CALIBRATED_RIG), context.read(RESIDUALS)
    if config.method == "none":
        refined = unchanged(rig, residuals, config, "refine.method is none")
    else:
        from wibam_core.refinement.refine import refine  # it needs torch, which takes seconds to import

        searched, detected = context.read(SEARCHED_INSTANTS), context.read(DETECTIONS)
        refined = refine(annotated(searched, detected), rig, residuals, config, context.progress)
    context.warn(*refined.cautions)
    context.write(RIG, refined.rig)
    context.write(REFINEMENT, refined.document)
    return refined.document.model_dump(exclude={"covariances"}, exclude_none=True)
