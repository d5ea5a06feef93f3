"""Refine the calibration by what several cameras see of the traffic."""

from __future__ import annotations

from wibam_core.artifacts.catalogue import (
    CALIBRATED_RIG,
    DETECTOR_REFINEMENT,
    DETECTOR_RIG,
    REFINEMENT,
    RESIDUALS,
    RIG,
    ROUND_DETECTIONS,
    ROUNDS,
    SEARCHED_INSTANTS,
)
from wibam_core.config import RefineConfig
from wibam_core.detection.instants import annotated
from wibam_core.refinement.cautions import cautions_of
from wibam_core.refinement.unchanged import Refined, unchanged
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: RefineConfig) -> Summary:
    """Write `RIG` and `REFINEMENT`, by the boxes of all rounds.

    Rounds have refined the cameras by the detector's boxes: where they found none beside these, that is the result.
    """
    if context.read(ROUNDS).kept == 0 and context.inputs.has(DETECTOR_RIG):
        refined = Refined(context.read(DETECTOR_RIG), context.read(DETECTOR_REFINEMENT))
    else:
        refined = _refined(context, config)
    context.warn(*cautions_of(refined.document))
    context.write(RIG, refined.rig)
    context.write(REFINEMENT, refined.document)
    return refined.document.model_dump(exclude={"covariances"}, exclude_none=True)


def _refined(context: StageContext, config: RefineConfig) -> Refined:
    rig, residuals = context.read(CALIBRATED_RIG), context.read(RESIDUALS)
    if config.method == "none":
        return unchanged(rig, residuals, config, "refine.method is none")
    from wibam_core.refinement.refine import refine  # it needs torch, which takes seconds to import

    searched, detected = context.read(SEARCHED_INSTANTS), context.read(ROUND_DETECTIONS)
    return refine(annotated(searched, detected), rig, residuals, config, context.progress)
