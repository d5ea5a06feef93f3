"""All cameras' frames through the fine-tuned network, once: evaluation and tracking both read its boxes."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from itertools import groupby

from wibam_core.artifacts.catalogue import FRAMES, PREDICTIONS, RIG, SPLIT, WEIGHTS
from wibam_core.config import PredictConfig
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.formats.framestore import FrameStore
from wibam_core.formats.predictions import PredictionsWriter
from wibam_core.models.network import Network, predict
from wibam_core.models.stored_frames import stored_frames
from wibam_core.networks.registry import load_to_detect
from wibam_core.scene import CameraRig, FrameSet, Vehicles3D
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: PredictConfig) -> Summary:
    """Write `PREDICTIONS`, of the instants that tracking asks for and of those of the test part.

    The evaluation is asked for weak boxes, too, of which there are many, and each is looked at twice: so only there.
    """
    rig, store, network = context.read(RIG), context.read(FRAMES), load_to_detect(context.read(WEIGHTS))
    test = set(context.read(SPLIT).times_ns["test"])
    wanted = test | {instant.time_ns for instant in store.thinned(config.rate_hz)}
    instants = [instant for instant in store.frame_sets if instant.time_ns in wanted]
    total = sum(len(rig.keys() & instant.frame_times_ns.keys()) for instant in instants)
    images = boxes = 0
    with PredictionsWriter(context.new_file(PREDICTIONS)) as writer:
        of_test = [instant for instant in instants if instant.time_ns in test]
        others = [instant for instant in instants if instant.time_ns not in test]
        found = heapq.merge(
            predictions(network, store, of_test, rig, config.test_min_score),
            predictions(network, store, others, rig, config.min_score),
            key=lambda vehicles: vehicles.time_ns,
        )
        for _, of_instant in groupby(found, key=lambda vehicles: vehicles.time_ns):
            vehicles = list(of_instant)
            writer.add(vehicles)
            images += len(vehicles)
            boxes += sum(map(len, vehicles))
            context.progress(images / total, f"{images} of {total} images")
    return {"instants": len(instants), "images": images, "boxes": boxes}


def predictions(
    network: Network, store: FrameStore, instants: Iterable[FrameSet], rig: CameraRig, min_score: float
) -> Iterator[Vehicles3D]:
    """What a fine-tuned network finds in every camera's image of the instants, in order of time, then of the rig.

    Boxes are placed, and their standard deviations stated, as its card says.
    """
    factors = SdFactors(**network.card.sd_factors)
    frames = stored_frames(store, instants, rig)
    found = predict(network, frames, decode=network.card.decode, min_score=min_score)
    return (factors.apply(vehicles) for vehicles in found)
