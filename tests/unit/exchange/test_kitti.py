"""KITTI: what is written comes back as far as the format goes; a real roadside data set is read."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import corner_rig, look_at
from tests.exchange_content import content
from wibam_core.errors import InputError
from wibam_core.exchange.kitti import Kitti
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import project_boxes
from wibam_core.geometry.se3 import SE3, normalise_angle
from wibam_core.scene import CameraRig, Vehicles3D


def level_camera() -> Camera:
    """At the origin, 1.5 m above the ground, looking along world Y."""
    rotation = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # columns: x right, y down, z forward
    K = np.array([[500.0, 0, 319.5], [0, 500, 179.5], [0, 0, 1]])
    return Camera(K, np.zeros(0), SE3(rotation, np.array([0, 0, 1.5])), 640, 360)


def test_round_trip_keeps_labels_with_their_visibility_in_steps(tmp_path: Path) -> None:
    whole = content()
    Kitti().write(whole, tmp_path)
    read = Kitti().read(tmp_path)
    given_labels = whole.labels or ()
    assert [instant.vehicles.time_ns for instant in read.labels or ()] == [i.vehicles.time_ns for i in given_labels]
    for a, b in zip(read.labels or (), given_labels, strict=True):
        order = np.argsort(a.vehicles.boxes[:, 2])
        expected = b.vehicles.boxes[np.argsort(b.vehicles.boxes[:, 2])]
        np.testing.assert_allclose(a.vehicles.boxes[order][:, :6], expected[:, :6], atol=1e-3)
        assert np.abs(normalise_angle(a.vehicles.boxes[order][:, 6] - expected[:, 6])).max() < 1e-3
        assert sorted(a.vehicles.classes.tolist()) == [0, 1, 2]
        for camera_id in whole.rig or ():
            assert a.visibility[camera_id][order].tolist() == [0.9, 0.6, 0.6]  # of 1, 0.75 and 0.5


def test_round_trip_keeps_the_cameras_and_what_each_saw_with_its_score(tmp_path: Path) -> None:
    whole = content()
    Kitti().write(whole, tmp_path)
    read = Kitti().read(tmp_path)
    assert read.rig is not None and whole.rig is not None
    for camera_id, camera in whole.rig.items():
        np.testing.assert_allclose(read.rig[camera_id].K, camera.K, rtol=1e-10)
        np.testing.assert_allclose(read.rig[camera_id].T_world_cam.matrix, camera.T_world_cam.matrix, atol=1e-9)
        assert (read.rig[camera_id].width_px, read.rig[camera_id].height_px) == (640, 360)
    seen = [v for v in read.boxes_3d or () if v.time_ns == 0]
    assert [v.camera_id for v in seen] == list(whole.rig)
    np.testing.assert_allclose(seen[0].scores, [0.9, 0.8, 0.7])
    np.testing.assert_allclose(seen[0].boxes, (whole.boxes_3d or ())[0].boxes, atol=1e-3)


def test_convention_kitti_of_a_level_camera(tmp_path: Path) -> None:
    """A car 10 m ahead and 2 m to the right that drives away is turned by −π/2 about the camera's y axis."""
    box = np.array([[2.0, 10.0, 0.75, 4.0, 1.8, 1.5, np.pi / 2]])
    rig = CameraRig({"front": level_camera()})
    Kitti().write(replace(content(), rig=rig, labels=None, boxes_3d=[Vehicles3D.of(0, box)]), tmp_path)
    words = (tmp_path / "front/data/000000.txt").read_text().split()
    assert words[0] == "Car"
    assert [float(w) for w in words[8:14]] == [1.5, 1.8, 4.0, 2.0, 1.5, 10.0]  # h w l, bottom at the height of the eye
    assert float(words[14]) == pytest.approx(-np.pi / 2, abs=1e-4)
    assert float(words[3]) == pytest.approx(-np.pi / 2 - np.arctan2(2, 10), abs=1e-4)


@given(yaw=st.floats(-3.14, 3.14), height=st.floats(2.0, 20.0), angle=st.floats(-3.0, 3.0))
def test_headings_of_pitched_cameras_come_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, yaw: float, height: float, angle: float
) -> None:
    folder = tmp_path_factory.mktemp("kitti")
    rig = CameraRig({"a": look_at((18 * np.cos(angle), 18 * np.sin(angle), height))})
    box = np.array([[1.0, -1.0, 0.75, 4.0, 1.8, 1.5, yaw]])
    Kitti().write(replace(content(), rig=rig, labels=None, boxes_3d=[Vehicles3D.of(0, box)]), folder)
    (found,) = Kitti().read(folder).boxes_3d or ()
    np.testing.assert_allclose(found.boxes[0, :6], box[0, :6], atol=1e-3)
    assert abs(normalise_angle(found.boxes[0, 6] - yaw)) < 1e-3


def test_a_reader_that_knows_no_ground_tilts_boxes_by_the_pitch_of_the_camera(tmp_path: Path) -> None:
    """What the format cannot hold: its up is the camera's, which a camera 20 degrees down has 20 degrees off."""
    camera = look_at((0.0, -20.0, 20.0 * np.tan(np.radians(20))))
    box = np.array([[0.0, 0.0, 0.75, 4.0, 1.8, 1.5, 0.0]])
    Kitti().write(
        replace(content(), rig=CameraRig({"a": camera}), labels=None, boxes_3d=[Vehicles3D.of(0, box)]), tmp_path
    )
    words = (tmp_path / "a/data/000000.txt").read_text().split()
    assert float(words[14]) == pytest.approx(0, abs=1e-6)  # across the view the heading itself is exact
    upright_for_kitti = camera.T_world_cam.rotate([0.0, -1.0, 0.0])
    assert np.degrees(np.arccos(upright_for_kitti[2])) == pytest.approx(20, abs=0.1)
    assert "pitch" in Kitti.loses


def test_what_a_camera_does_not_see_is_not_in_its_files(tmp_path: Path) -> None:
    behind = np.array([[0.0, -30.0, 0.75, 4.0, 1.8, 1.5, 0.0], [0.0, 12.0, 0.75, 4.0, 1.8, 1.5, 0.0]])
    rig = CameraRig({"front": level_camera()})
    Kitti().write(replace(content(), rig=rig, labels=None, boxes_3d=[Vehicles3D.of(0, behind)]), tmp_path)
    assert len((tmp_path / "front/data/000000.txt").read_text().splitlines()) == 1


def test_truncation_is_the_share_of_the_box_outside_the_image(tmp_path: Path) -> None:
    """At 10 m, 500 px and 640 px width, the image ends 6.39 m to the right: a flat box there is cut in the middle."""
    flat = np.array([[6.39, 10.0, 0.75, 2.0, 1e-6, 1.0, 0.0]])
    rig = CameraRig({"front": level_camera()})
    Kitti().write(replace(content(), rig=rig, labels=None, boxes_3d=[Vehicles3D.of(0, flat)]), tmp_path)
    assert float((tmp_path / "front/data/000000.txt").read_text().split()[1]) == pytest.approx(0.5, abs=0.02)


def test_lenses_with_distortion_are_said_to_lose_it() -> None:
    assert "distortion" in Kitti.loses


@pytest.fixture
def roadside(assets: Path, tmp_path: Path) -> Path:
    """The real image in the folders that its data set has."""
    folder = tmp_path / "roadside"
    for name, file in (
        ("calib", "calib.txt"),
        ("denorm", "denorm.txt"),
        ("label_2", "label_2.txt"),
        ("image_2", "image_2.jpg"),
    ):
        (folder / name).mkdir(parents=True)
        shutil.copy(assets / "roadside" / file, folder / name / f"000000{Path(file).suffix}")
    return folder


@pytest.mark.assets
def test_a_real_roadside_label_file_is_read_onto_its_ground(roadside: Path) -> None:
    read = Kitti().read(roadside)
    assert read.rig is not None
    camera = read.rig["roadside"]
    assert (camera.width_px, camera.height_px) == (1920, 1080)
    (instant,) = read.labels or ()
    cars = instant.vehicles.where(instant.vehicles.classes == 0)
    assert len(cars) == 15
    assert np.abs(cars.boxes[:, 2] - cars.boxes[:, 5] / 2).max() < 0.4  # they stand on Z = 0
    lines = [line.split() for line in (roadside / "label_2/000000.txt").read_text().splitlines()]
    labelled = np.array([[float(w) for w in words[4:8]] for words in lines if words[0] == "car"])
    overlaps = np.diag(image_iou(project_boxes(camera, cars.boxes), labelled))
    assert np.median(overlaps) > 0.97
    assert min(overlaps) > 0.95
    assert "21 boxes of type trafficcone were left out" in read.notes


def minimal(folder: Path) -> Path:
    camera = folder / "front"
    (camera / "calib").mkdir(parents=True)
    (camera / "label_2").mkdir()
    lines = [
        "P2: 500 0 320 0 0 500 180 0 0 0 1 0",
        "R0_rect: 1 0 0 0 1 0 0 0 1",
        "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 1.5 1 0 0 0",
        "S_rect_02: 640 360",
    ]
    (camera / "calib/000000.txt").write_text("\n".join(lines))
    (camera / "label_2/000000.txt").write_text(
        "Car 0 0 0 1 2 3 4 1.5 1.8 4 0 1.5 10 0\nDontCare -1 -1 -10 0 0 9 9 -1 -1 -1 -1000 -1000 -1000 -10\n"
    )
    return camera


def test_kitti_s_own_layout_is_read_and_regions_that_nobody_labelled_are_noted(tmp_path: Path) -> None:
    read = Kitti().read(minimal(tmp_path))
    (instant,) = read.labels or ()
    # ten metres ahead (x), across the view to the right: yaw −π/2
    np.testing.assert_allclose(instant.vehicles.boxes, [[10, 0, 0.75, 4, 1.8, 1.5, -np.pi / 2]], atol=1e-12)
    assert read.notes == ("1 boxes of type DontCare were left out",)


@pytest.mark.parametrize(
    ("file", "text", "problem"),
    [
        ("calib/000000.txt", "P2: 1 2 3", "P2: 12 finite numbers"),
        ("calib/000000.txt", "P2: x", "P2: numbers are needed"),
        ("calib/000000.txt", "P2: 0 0 0 0 0 0 0 0 0 0 1 0\nTr_velo_to_cam: 1 0 0 0 0 1 0 0 0 0 1 0", "P2"),
        ("calib/000000.txt", "P2: 5 0 3 0 0 5 1 0 0 0 1 0\nTr_velo_to_cam: 2 0 0 0 0 1 0 0 0 0 1 0", "Tr_velo_to_cam"),
        ("calib/000000.txt", "P2: 5 0 3 0 0 5 1 0 0 0 1 0", "says where the ground lies"),
        ("calib/000000.txt", "P2: 5 0 3 0 0 5 1 0 0 0 1 0\nTr_velo_to_cam: 1 0 0 0 0 1 0 0 0 0 1 0", "the size of the"),
        ("calib/left.txt", "", "named by numbers"),
        ("label_2/000000.txt", "Car 0 0", "line 1: 14 finite numbers"),
        ("label_2/000000.txt", "Car a b", "line 1: after the type"),
        ("label_2/000000.txt", "\nCar 0 0 0 1 2 3 4 1.5 1.8 4 0 inf 10 0", "line 2: 14 finite numbers"),
        ("times.txt", "soon", "times.txt: seconds"),
    ],
)
def test_what_cannot_be_is_refused_by_file_and_field(tmp_path: Path, file: str, text: str, problem: str) -> None:
    folder = minimal(tmp_path)
    (folder / file).write_text(text)
    with pytest.raises(InputError, match=problem) as refused:
        Kitti().read(folder)
    assert refused.value.hint


def test_a_camera_that_moves_is_refused(tmp_path: Path) -> None:
    folder = minimal(tmp_path)
    moved = (folder / "calib/000000.txt").read_text().replace("1.5 1 0 0 0", "1.5 1 0 0 0.3")
    (folder / "calib/000001.txt").write_text(moved)
    with pytest.raises(InputError, match="the camera moves"):
        Kitti().read(folder)


def test_without_labels_or_boxes_there_is_nothing_to_write(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="needs labels or boxes 3d"):
        Kitti().write(replace(content(), labels=None, boxes_3d=None, rig=corner_rig(2)), tmp_path)
