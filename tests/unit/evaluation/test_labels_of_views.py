"""Labels of a camera, told for each of its views."""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders import corner_rig
from wibam_core.calibration.views import cut_view
from wibam_core.evaluation.labels_of_views import labels_of_views
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import CameraRig, LabelledInstant, Vehicles3D
from wibam_core.site import ViewDirection

K = np.array([[322.0, 0, 639.5], [0, 322.0, 479.5], [0, 0, 1]])
CAMERA = Camera(K, np.zeros(0), SE3(np.diag([1.0, -1, -1]), np.array([0.0, 0, 10])), 1280, 960, "fisheye")
VIEWS = tuple(
    cut_view(CAMERA, ViewDirection(azimuth_deg=azimuth, down_deg=0, height_deg=100), f"pole.{number}")
    for number, azimuth in enumerate((45.0, -45.0), 1)
)


def test_a_view_shows_the_share_that_is_in_it_of_what_its_camera_sees() -> None:
    def car(x: float, y: float) -> list[float]:
        return [x, y, 0.8, 4.0, 1.8, 1.6, np.pi / 2]

    # to the left, to the right, and across the line between the views, the X axis
    vehicles = Vehicles3D.of(0, np.array([car(10, 10), car(10, -10), car(15, 0)]))
    label = LabelledInstant(vehicles, {"pole": np.array([0.8, 1.0, 0.6]), "other": np.array([1.0, 0.0, 0.5])})
    rig = CameraRig({"pole": CAMERA, "other": corner_rig()["cam1"]}, {"pole": VIEWS})
    (told,) = labels_of_views([label], rig)
    assert set(told.visibility) == {"pole.1", "pole.2", "other"}
    np.testing.assert_allclose(told.visibility["pole.1"][:2], [0.8, 0.0])
    np.testing.assert_allclose(told.visibility["pole.2"][:2], [0.0, 1.0])
    assert told.visibility["pole.1"][2] == pytest.approx(0.3, abs=0.06)
    assert told.visibility["pole.2"][2] == pytest.approx(0.3, abs=0.06)
    np.testing.assert_array_equal(told.visibility["other"], [1.0, 0.0, 0.5])


def test_without_views_labels_stay_as_they_are() -> None:
    label = LabelledInstant(Vehicles3D.of(0, np.zeros((0, 7))), {})
    assert labels_of_views([label], corner_rig()) == [label]
