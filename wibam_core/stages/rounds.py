"""Let what several cameras agree on teach a network, which finds what the detector overlooked."""

from __future__ import annotations

from wibam_core.artifacts.catalogue import (
    CALIBRATED_RIG,
    DETECTIONS,
    DETECTOR_REFINEMENT,
    DETECTOR_RIG,
    FRAMES,
    RESIDUALS,
    ROUND_DETECTIONS,
    ROUNDS,
    SEARCHED_INSTANTS,
    TIMESTAMPS,
)
from wibam_core.config import AssociateConfig, DatasetConfig, DetectConfig, LiftConfig, RefineConfig, RoundsConfig
from wibam_core.detection.instants import annotated
from wibam_core.detection.second_look import backgrounds_shown
from wibam_core.documents.rounds import Rounds
from wibam_core.models.weights import bundled
from wibam_core.progress import part
from wibam_core.stages.base import StageContext, Summary

#: The share of the work after which the cameras are refined.
_REFINED = 0.1


def run(context: StageContext, config: RoundsConfig) -> Summary:
    """Write `ROUND_DETECTIONS`, the boxes that the stages after it work on, and `ROUNDS`, what each round gained.

    Views agree only as far as cameras are right, so that these are refined first by what the detector found
    (`DETECTOR_RIG`, `DETECTOR_REFINEMENT`); the next stage does so by all boxes.
    """
    detected = context.read(DETECTIONS)
    if not config.asked_for:
        context.write(ROUND_DETECTIONS, detected)
        context.write(ROUNDS, Rounds(rounds=[], kept=0, reason="rounds are switched off"))
        return {"rounds": 0, "kept": 0}
    from wibam_core.refinement.refine import refine  # torch takes seconds to import
    from wibam_core.rounds.rounds import run_rounds
    from wibam_core.rounds.world import Options, World

    store, times_ns, searched = context.read(FRAMES), context.read(TIMESTAMPS), context.read(SEARCHED_INSTANTS)
    refined = refine(
        annotated(searched, detected),
        context.read(CALIBRATED_RIG),
        context.read(RESIDUALS),
        context.options_of(RefineConfig),
        part(context.progress, 0.0, _REFINED),
    )
    context.write(DETECTOR_RIG, refined.rig)
    context.write(DETECTOR_REFINEMENT, refined.document)
    options = Options(
        config,
        context.options_of(DetectConfig),
        context.options_of(AssociateConfig),
        context.options_of(DatasetConfig),
        context.options_of(LiftConfig),
    )
    world = World(
        refined.rig,
        refined.covariances,
        store,
        searched,
        backgrounds_shown(store, times_ns, options.detect.background_s, refined.rig),
        bundled("mono_small.safetensors"),
        options,
        context.scratch,
    )
    found, rounds = run_rounds(world, detected, part(context.progress, _REFINED, 1.0))
    context.write(ROUND_DETECTIONS, found)
    context.write(ROUNDS, rounds)
    said = {"rounds": max(len(rounds.rounds) - 1, 0), "kept": rounds.kept, "reason": rounds.reason}
    if rounds.rounds:
        first, last = rounds.rounds[0], rounds.rounds[rounds.kept]
        said["agreement"] = {"before": first.agreement.model_dump(), "after": last.agreement.model_dump()}
    return said
