"""Let what several cameras agree on teach a network, which finds what the detector overlooked."""

from __future__ import annotations

import numpy as np

from wibam_core.artifacts.catalogue import (
    DETECTIONS,
    FRAMES,
    REFINEMENT,
    RIG,
    ROUND_DETECTIONS,
    ROUNDS,
    SEARCHED_INSTANTS,
    TIMESTAMPS,
)
from wibam_core.config import AssociateConfig, DatasetConfig, DetectConfig, LiftConfig, RoundsConfig
from wibam_core.detection.second_look import backgrounds_shown
from wibam_core.documents.rounds import Rounds
from wibam_core.models.weights import bundled
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: RoundsConfig) -> Summary:
    """Write `ROUND_DETECTIONS`, the boxes that the stages after it work on, and `ROUNDS`, what each round gained."""
    detected = context.read(DETECTIONS)
    if not config.asked_for:
        context.write(ROUND_DETECTIONS, detected)
        context.write(ROUNDS, Rounds(rounds=[], kept=0, reason="rounds are switched off"))
        return {"rounds": 0, "kept": 0}
    from wibam_core.rounds.rounds import run_rounds  # torch takes seconds to import
    from wibam_core.rounds.world import Options, World

    rig, store = context.read(RIG), context.read(FRAMES)
    times_ns, searched = context.read(TIMESTAMPS), context.read(SEARCHED_INSTANTS)
    options = Options(
        config,
        context.options_of(DetectConfig),
        context.options_of(AssociateConfig),
        context.options_of(DatasetConfig),
        context.options_of(LiftConfig),
    )
    world = World(
        rig,
        {name: np.array(matrix) for name, matrix in context.read(REFINEMENT).covariances.items()},
        store,
        searched,
        backgrounds_shown(store, times_ns, options.detect.background_s, rig),
        bundled("mono_small.safetensors"),
        options,
        context.scratch,
    )
    found, rounds = run_rounds(world, detected, context.progress)
    context.write(ROUND_DETECTIONS, found)
    context.write(ROUNDS, rounds)
    said = {"rounds": max(len(rounds.rounds) - 1, 0), "kept": rounds.kept, "reason": rounds.reason}
    if rounds.rounds:
        first, last = rounds.rounds[0], rounds.rounds[rounds.kept]
        said["agreement"] = {"before": first.agreement.model_dump(), "after": last.agreement.model_dump()}
    return said
