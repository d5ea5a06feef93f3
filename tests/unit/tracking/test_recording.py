from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from wibam_core.config import TrackConfig
from wibam_core.geometry.ground import intersect_plane
from wibam_core.models.weights import bundled
from wibam_core.networks.registry import load_network
from wibam_core.tracking.recording import track_recording
from wibam_core.tracking.uncalibrated import NOMINAL_HEIGHT_M, nominal_camera
from wibam_core.video.decode import decode


def test_the_nominal_camera_looks_along_y_with_its_horizon_where_it_is_put() -> None:
    camera = nominal_camera(640, 360, horizon_px=100.0)
    far, _ = camera.project([0.0, 1e7, 0.0])
    assert far == pytest.approx([319.5, 100.0], abs=1e-2)
    assert camera.centre_m == pytest.approx([0, 0, NOMINAL_HEIGHT_M])
    right, _ = camera.project([5.0, 40.0, 0.0])
    assert right[0] > 319.5
    assert intersect_plane(camera, [319.5, 359.0])[1] > 0


def test_rows_above_the_horizon_never_meet_the_ground() -> None:
    camera = nominal_camera(640, 360)
    assert np.isnan(intersect_plane(camera, [300.0, 50.0])).all()


@pytest.mark.assets
def test_the_real_clip_is_tracked_without_a_calibration(assets: Path) -> None:
    frames = islice(decode(assets / "footage" / "traffic.mp4"), 0, 64, 4)
    network = load_network(bundled("mono_small.safetensors"))
    config = TrackConfig(min_score=0.1, min_hits=1)
    tracks = track_recording(network, frames, nominal_camera(640, 360), config, decode="plane")
    for track in tracks:
        assert np.isfinite(track.boxes).all()
        assert np.isfinite(track.velocities_mps).all()
        assert (track.boxes[:, 1] > 0).all()  # in front of the camera
