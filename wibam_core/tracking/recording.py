"""Tracks from one camera's recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from wibam_core.config import TrackConfig
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.cut_view import Cutter, CutView
from wibam_core.models.frames import Frame
from wibam_core.models.network import Network, predict
from wibam_core.placing import Decode
from wibam_core.scene import CameraRig, Track
from wibam_core.tracking.one_per_camera import found_once
from wibam_core.tracking.tracker import Tracker


def track_recording(
    network: Network,
    images: Iterable[tuple[int, NDArray[np.uint8]]],
    camera: Camera,
    config: TrackConfig,
    *,
    decode: Decode,
    factors: SdFactors = SdFactors(),
    views: Sequence[CutView] = (),
) -> list[Track]:
    """Detect in each image and track.

    Args:
        network: the 3D detector.
        images: (time in ns, BGR image (H, W, 3) uint8), in order of time; ``config.rate_hz`` is the caller's.
        camera: of the recording; any size with the images' aspect ratio.
        config: thresholds.
        decode: how boxes are placed, as the network can.
        factors: what the network's standard deviations are multiplied with.
        views: of a wide lens, in which the network detects instead of the whole picture.
    """
    tracker = Tracker(config)
    rig = CameraRig({"camera": camera}, {"camera": tuple(views)} if views else {})

    def frames() -> Iterator[Frame]:
        cutters: dict[str, Cutter] = {}
        for time_ns, image in images:
            if not views:
                yield Frame(image, camera, "camera", time_ns)
                continue
            if not cutters:
                of_size = camera.resized(image.shape[1], image.shape[0])
                cutters = {view.id: view.cutter(of_size) for view in views}
            for view_id, cutter in cutters.items():
                yield Frame(cutter.cut(image), rig[view_id], view_id, time_ns)

    found = predict(network, frames(), decode=decode, min_score=config.min_score)
    for time_ns, detections in groupby(found, key=lambda vehicles: vehicles.time_ns):
        of_frame = [factors.apply(vehicles) for vehicles in detections]
        tracker.step(time_ns, found_once(of_frame, rig, config.fusion_radius_m))
    return tracker.tracks()
