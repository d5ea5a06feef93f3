"""All cameras' frames through the fine-tuned detector, to smoothed 7DoF tracks."""

from __future__ import annotations

from collections import Counter
from itertools import groupby

from wibam_core.artifacts.catalogue import FRAMES, RIG, TRACKS, WEIGHTS
from wibam_core.config import TrackConfig
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.models.network import predict
from wibam_core.models.stored_frames import stored_frames
from wibam_core.networks.registry import load_to_detect
from wibam_core.stages.base import StageContext, Summary
from wibam_core.tracking.one_per_camera import found_once
from wibam_core.tracking.tracker import Tracker


def run(context: StageContext, config: TrackConfig) -> Summary:
    """Write `TRACKS`: every vehicle at ``config.rate_hz``, with no track where nothing was seen."""
    rig, store, network = context.read(RIG), context.read(FRAMES), load_to_detect(context.read(WEIGHTS))
    factors = SdFactors(**network.card.sd_factors)
    instants = store.thinned(config.rate_hz)
    frame_times = {instant.time_ns: instant.frame_times_ns for instant in instants}
    total = sum(len(rig.keys() & instant.frame_times_ns.keys()) for instant in instants)
    tracker = Tracker(config)
    frames = stored_frames(store, instants, rig)
    found = predict(network, frames, decode=network.card.decode, min_score=config.min_score)
    done = 0
    for time_ns, detections in groupby(found, key=lambda vehicles: vehicles.time_ns):
        of_instant = [factors.apply(vehicles) for vehicles in detections]
        if rig.views:
            of_instant = found_once(of_instant, rig, config.fusion_radius_m)
        tracker.step(time_ns, of_instant, frame_times[time_ns])
        done += len(of_instant)
        context.progress(done / total, f"Tracking: {done} of {total} images")
    tracks = tracker.tracks()
    context.write(TRACKS, tracks)
    classes = Counter(track.vehicle_class.value for track in tracks)
    return {"tracks": len(tracks), "instants": len(instants), "by_class": dict(sorted(classes.items()))}
