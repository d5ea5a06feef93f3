"""What the fine-tuned network found in all cameras' frames, to smoothed 7DoF tracks."""

from __future__ import annotations

from collections import Counter

from wibam_core.artifacts.catalogue import FRAMES, PREDICTIONS, RIG, TRACKS, USUAL
from wibam_core.config import TrackConfig
from wibam_core.stages.base import StageContext, Summary
from wibam_core.tracking.one_per_camera import found_once
from wibam_core.tracking.tracker import Tracker
from wibam_core.watching.usual import Noticed


def run(context: StageContext, config: TrackConfig) -> Summary:
    """Write `TRACKS`: every vehicle at ``config.rate_hz``, with no track where nothing was seen. And `USUAL`."""
    rig, predictions = context.read(RIG), context.read(PREDICTIONS)
    store = context.read(FRAMES)
    instants = store.thinned(config.rate_hz)
    frame_times = {instant.time_ns: instant.frame_times_ns for instant in instants}
    tracker, noticed = Tracker(config), Noticed((instants[-1].time_ns - instants[0].time_ns) * 1e-9)
    for number, (time_ns, found) in enumerate(predictions.at(frame_times.keys()), 1):
        of_views = [found[camera_id] for camera_id in rig if camera_id in found]
        of_instant = [vehicles.where(vehicles.scores >= config.min_score) for vehicles in of_views]
        for vehicles in of_instant:
            camera_id = str(vehicles.camera_id)
            noticed.find(camera_id, vehicles.scores)
            if noticed.wants(camera_id, time_ns):
                noticed.see(camera_id, time_ns, store.image(camera_id, time_ns))
        if rig.views:
            of_instant = found_once(of_instant, rig, config.fusion_radius_m)
        tracker.step(time_ns, of_instant, frame_times[time_ns])
        context.progress(number / len(instants), f"{number} of {len(instants)} instants")
    tracks = tracker.tracks()
    context.write(TRACKS, tracks)
    context.write(USUAL, noticed.usual())
    classes = Counter(track.vehicle_class.value for track in tracks)
    return {"tracks": len(tracks), "instants": len(instants), "by_class": dict(sorted(classes.items()))}
