"""Tracks from one camera's recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from wibam_core.config import TrackConfig
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.geometry.camera import Camera
from wibam_core.models.frames import Frame
from wibam_core.models.network import Network, predict
from wibam_core.placing import Decode
from wibam_core.scene import Track
from wibam_core.tracking.tracker import Tracker


def track_recording(
    network: Network,
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
        decode: how boxes are placed, as the network can.
        factors: what the network's standard deviations are multiplied with.
    """
    tracker = Tracker(config)

    def frames() -> Iterator[Frame]:
        for time_ns, image in images:
            yield Frame(image, camera, "camera", time_ns)

    for found in predict(network, frames(), decode=decode, min_score=config.min_score):
        tracker.step(found.time_ns, [factors.apply(found)])
    return tracker.tracks()
