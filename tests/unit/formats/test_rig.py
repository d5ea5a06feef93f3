import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import corner_rig
from wibam_core.errors import CalibrationError
from wibam_core.formats.rig import read_rig, write_rig
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.cut_view import CutView
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


def test_a_wide_lens_and_its_views_come_back(tmp_path: Path) -> None:
    K = np.array([[322.1, 0, 632.7], [0, 321.9, 473.8], [0, 0, 1]])
    pose = SE3.from_rvec_tvec(np.array([2.9, -1.3, 0.2]), np.array([1.7, -22.4, 8.4])).inverse()
    camera = Camera(K, np.array([-0.06, 0.01, 0.001, -0.0008]), pose, 1280, 960, "omnidirectional", 1.1)
    view = CutView(
        "z.1", SE3.from_rvec_tvec(np.array([0.1, 0.9, 0.3]), np.zeros(3)).rotation, corner_rig()["cam1"].K, 640, 360
    )
    rig = CameraRig({"z": camera, "a": corner_rig()["cam1"]}, {"z": (view,)})
    write_rig(tmp_path / "rig.json", rig)
    back = read_rig(tmp_path / "rig.json")
    assert list(back) == ["z.1", "a"]
    assert (back.reference_id, back.mounted_id("z.1"), back.mounted_id("a")) == ("z", "z", "a")
    assert (back.mounted["z"].lens, back.mounted["z"].xi) == ("omnidirectional", 1.1)
    for one, again in ((rig["z.1"], back["z.1"]), (camera, back.mounted["z"])):
        np.testing.assert_array_equal(one.K, again.K)
        np.testing.assert_allclose(one.T_world_cam.matrix, again.T_world_cam.matrix, atol=1e-14)
        assert one.size_px == again.size_px
    entries = json.loads((tmp_path / "rig.json").read_text())["cameras"]
    assert "lens" not in entries[1]  # a pinhole's entry is as it ever was
    entries[1]["views"] = entries[0]["views"]
    entries[0]["views"] = []
    (tmp_path / "bad.json").write_text(json.dumps({"format": "wibam-rig", "version": 1, "cameras": entries}))
    with pytest.raises(CalibrationError, match="no wide lens"):
        read_rig(tmp_path / "bad.json")
