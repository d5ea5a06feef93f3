"""The nuScenes devkit takes our results as a submission. It needs NumPy below 2: run `make test-readers`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.exchange_content import content
from wibam_core.exchange.nuscenes import NuScenesResults

_WHY = "nuscenes-devkit is not installed: run `make test-readers`"
loaders = pytest.importorskip("nuscenes.eval.common.loaders", reason=_WHY)
data_classes = pytest.importorskip("nuscenes.eval.detection.data_classes", reason=_WHY)
pyquaternion = pytest.importorskip("pyquaternion", reason=_WHY)


def test_the_devkit_reads_samples_and_boxes(tmp_path: Path) -> None:
    given = content().boxes_3d or ()
    (path,) = NuScenesResults().write(content(), tmp_path)
    found, meta = loaders.load_prediction(str(path), 500, data_classes.DetectionBox)
    assert meta["use_camera"] is True
    assert set(found.sample_tokens) == {str(vehicles.time_ns) for vehicles in given}
    for vehicles in given:
        for box, expected in zip(found[str(vehicles.time_ns)], vehicles.boxes, strict=True):
            np.testing.assert_allclose([*box.translation, *box.size], expected[[0, 1, 2, 4, 3, 5]])
            yaw, pitch, roll = pyquaternion.Quaternion(box.rotation).yaw_pitch_roll
            np.testing.assert_allclose([yaw, pitch, roll], [expected[6], 0, 0], atol=1e-9)
