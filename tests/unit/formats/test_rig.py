import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.errors import CalibrationError
from wibam_core.formats.rig import read_rig, write_rig
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import CameraRig

K = np.array([[900.0, 0.0, 639.5], [0.0, 910.0, 359.5], [0.0, 0.0, 1.0]])


@given(
    rvec=st.tuples(*[st.floats(-3, 3)] * 3),
    tvec=st.tuples(*[st.floats(-100, 100)] * 3),
    dist=st.sampled_from([(), (-0.2, 0.05, 1e-3, -1e-3), (-0.2, 0.05, 1e-3, -1e-3, 0.01)]),
)
def test_round_trip_keeps_cameras_and_order(rvec, tvec, dist, tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "rig.json"
    one = Camera(K, np.array(dist), SE3.from_rvec_tvec(rvec, tvec).inverse(), 1280, 720)
    two = Camera(K, np.zeros(0), SE3.identity(), 1280, 720)
    write_rig(path, CameraRig({"z": one, "a": two}))
    rig = read_rig(path)
    assert list(rig) == ["z", "a"]
    assert rig.reference_id == "z"
    np.testing.assert_array_equal(rig["z"].K, one.K)
    np.testing.assert_array_equal(rig["z"].dist, one.dist)
    np.testing.assert_allclose(rig["z"].T_world_cam.matrix, one.T_world_cam.matrix, atol=1e-12)
    assert (rig["z"].width_px, rig["z"].height_px) == (1280, 720)


def test_convention_pose_in_the_file_takes_camera_points_to_the_world(tmp_path):
    path = tmp_path / "rig.json"
    down = SE3(np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]), np.array([1.0, 2.0, 10.0]))
    write_rig(path, CameraRig({"a": Camera(K, np.zeros(0), down, 1280, 720)}))
    entry = json.loads(path.read_text())["cameras"][0]
    matrix = np.array(entry["T_world_cam"])
    np.testing.assert_allclose(matrix @ [0, 0, 10, 1], [1, 2, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"T_world_cam": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]]}, "mirrored"),
        ({"K": [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "focal"),
        ({"dist": [0.1]}, "coefficients"),
        ({"width_px": 0}, "width_px"),
        ({"dist": ["x"]}, "dist"),
    ],
)
def test_improper_cameras_are_refused(tmp_path, change, match):
    path = tmp_path / "rig.json"
    write_rig(path, CameraRig({"a": Camera(K, np.zeros(0), SE3.identity(), 1280, 720)}))
    document = json.loads(path.read_text())
    document["cameras"][0].update(change)
    path.write_text(json.dumps(document))
    with pytest.raises(CalibrationError, match=match):
        read_rig(path)


def test_a_missing_file_says_so(tmp_path):
    with pytest.raises(CalibrationError, match="does not exist"):
        read_rig(tmp_path / "rig.json")
