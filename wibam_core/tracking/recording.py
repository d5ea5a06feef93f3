"""Tracks from one camera's recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from wibam_core.config import TrackConfig
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.geometry.camera import Camera
from wibam_core.models.frames import Frame
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.dla34.centertrack import predict_vehicles
from wibam_core.networks.small.predict import RunnableNetwork, predict
from wibam_core.placing import Decode
from wibam_core.scene import Track
from wibam_core.tracking.tracker import Tracker


def track_recording(
    network: RunnableNetwork | DLA34,
    images: Iterable[tuple[int, NDArray[np.uint8]]],
    camera: Camera,
    config: TrackConfig,
    *,
    decode: Decode,
    factors: SdFactors = SdFactors(),
) -> list[Track]:
    """Detect in each image and track.

    Args:
        network: the 3D detector.
        images: (time in ns, BGR image (H, W, 3) uint8), in order of time; ``config.rate_hz`` is the caller's.
        camera: of the recording; any size with the images' aspect ratio.
        config: thresholds.
        decode: how boxes are placed along the ray; DLA-34's by "depth" or "plane".
        factors: what the network's standard deviations are multiplied with.
    """
    tracker = Tracker(config)

    def frames() -> Iterator[Frame]:
        for time_ns, image in images:
            yield Frame(image, camera, "camera", time_ns)

    if isinstance(network, DLA34):
        detected = predict_vehicles(network, frames(), decode=decode, min_score=config.min_score)
    else:
        detected = predict(network, frames(), decode=decode, min_score=config.min_score)
    for found in detected:
        tracker.step(found.time_ns, [factors.apply(found)])
    return tracker.tracks()
