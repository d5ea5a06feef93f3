"""OpenLABEL: what is written comes back and is valid by ASAM's schema; scenes as TUM Traffic writes them are read."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.builders import corner_rig
from tests.exchange_content import content
from wibam_core.errors import InputError
from wibam_core.exchange.base import Content
from wibam_core.exchange.openlabel import OpenLabel
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, LabelledInstant, Vehicles3D


def through(folder: Path, given: Content) -> Content:
    OpenLabel().write(given, folder)
    return OpenLabel().read(folder)


def test_round_trip_keeps_the_calibration(tmp_path: Path) -> None:
    rig = corner_rig(3, dist=(-0.2, 0.05, 0.001, -0.002))
    read = through(tmp_path, Content(rig=rig)).rig
    assert read is not None and list(read) == list(rig)
    for camera_id, camera in rig.items():
        found = read[camera_id]
        np.testing.assert_allclose(found.K, camera.K)
        np.testing.assert_allclose(found.dist, [*camera.dist, 0.0])  # the schema wants a fifth coefficient
        np.testing.assert_allclose(found.T_world_cam.matrix, camera.T_world_cam.matrix, atol=1e-12)
        assert (found.width_px, found.height_px) == (camera.width_px, camera.height_px)
    assert not through(tmp_path, Content(rig=corner_rig(2))).rig["cam1"].has_distortion  # type: ignore[index]


def test_round_trip_keeps_tracks(tmp_path: Path) -> None:
    given = content()
    read = through(tmp_path, given).tracks or ()
    for a, b in zip(read, given.tracks or (), strict=True):
        assert (a.track_id, a.vehicle_class) == (b.track_id, b.vehicle_class)
        np.testing.assert_array_equal(a.times_ns, b.times_ns)
        np.testing.assert_allclose(a.boxes, b.boxes, atol=1e-12)
        np.testing.assert_allclose(a.sd, b.sd)
        np.testing.assert_allclose(a.velocities_mps, b.velocities_mps)
        np.testing.assert_allclose(a.yaw_rates_radps, b.yaw_rates_radps)


def assert_same_vehicles(a: Vehicles3D, b: Vehicles3D) -> None:
    assert (a.time_ns, a.camera_id) == (b.time_ns, b.camera_id)
    np.testing.assert_allclose(a.boxes, b.boxes, atol=1e-12)
    np.testing.assert_array_equal(a.classes, b.classes)
    np.testing.assert_array_equal(a.ids, b.ids)
    np.testing.assert_allclose(a.scores, b.scores)
    np.testing.assert_array_equal(a.sd, b.sd)


def test_round_trip_keeps_3d_boxes_of_each_camera_and_empty_instants(tmp_path: Path) -> None:
    given = content()
    first, second, *_ = given.boxes_3d or ()
    boxes = [first, replace(first, camera_id="cam2"), second.where(np.zeros(3, bool))]
    read = through(tmp_path, replace(given, boxes_3d=boxes)).boxes_3d or ()
    for a, b in zip(read, boxes, strict=True):
        assert_same_vehicles(a, b)


def test_a_class_that_changes_within_a_track_stays_with_its_box(tmp_path: Path) -> None:
    instants = [
        Vehicles3D.of(t, np.array([[0, 0, 1, 4, 2, 2, 0.0]]), np.array([c]), np.array([7])) for t, c in ((0, 0), (1, 1))
    ]
    read = through(tmp_path, Content(rig=corner_rig(1), boxes_3d=instants)).boxes_3d or ()
    assert [int(vehicles.classes[0]) for vehicles in read] == [0, 1]


def test_round_trip_keeps_labels_with_their_visibility(tmp_path: Path) -> None:
    given = content()
    nothing = LabelledInstant(Vehicles3D.of(10**12, np.empty((0, 7))), {})
    labels = [*(given.labels or ()), nothing]
    read = through(tmp_path, replace(given, labels=labels)).labels or ()
    for a, b in zip(read, labels, strict=True):
        assert_same_vehicles(a.vehicles, b.vehicles)
        assert list(a.visibility) == list(b.visibility)
        for camera_id, shares in a.visibility.items():
            np.testing.assert_allclose(shares, b.visibility[camera_id])


def by_box(instant: AnnotatedInstant) -> dict[str, Any]:
    """Detections and vehicles regardless of the order of boxes."""
    rows = {
        camera_id: sorted(
            (*np.round(box, 9).tolist(), float(score), int(number))
            for box, score, number in zip(seen.boxes, seen.scores, seen.classes, strict=True)
        )
        for camera_id, seen in instant.detections.items()
    }
    vehicles = {
        v.obj_id: (
            *(v.track_id, v.vehicle_class, v.x_m, v.y_m),
            {c: np.round(instant.detections[c].boxes[i], 9).tolist() for c, i in v.views.items()},
        )
        for v in instant.vehicles
    }
    times = {camera_id: seen.frame_time_ns for camera_id, seen in instant.detections.items()}
    return {"time_ns": instant.time_ns, "rows": rows, "vehicles": vehicles, "times": times}


def test_round_trip_keeps_2d_boxes_times_and_associations(tmp_path: Path) -> None:
    given = content()
    empty = Detections2D("cam2", 999, np.empty((0, 4)), np.empty(0), np.empty(0, np.int64))
    instants = [*(given.instants or ()), AnnotatedInstant(10**9, {"cam2": empty})]
    read = through(tmp_path, replace(given, instants=instants)).instants or ()
    assert [by_box(instant) for instant in read] == [by_box(instant) for instant in instants]


def test_convention_a_cuboid_is_centre_quaternion_size_and_a_box_is_centre_size(tmp_path: Path) -> None:
    paths = {path.stem: path for path in OpenLabel().write(content(), tmp_path)}
    frame = json.loads(paths["openlabel_tracks"].read_text())["openlabel"]["frames"]["0"]
    # the van, of yaw 3π/4
    (cuboid,) = frame["objects"]["11"]["object_data"]["cuboid"]
    half = 3 * np.pi / 8
    expected = [4.0, 5.0, 1.1, 0, 0, np.sin(half), np.cos(half), 5.3, 2.0, 2.2]
    np.testing.assert_allclose(cuboid["val"], expected, atol=1e-12)
    frame = json.loads(paths["openlabel_boxes_2d"].read_text())["openlabel"]["frames"]["0"]
    seen = (content().instants or ())[0].detections["cam1"]
    bbox = frame["objects"]["10"]["object_data"]["bbox"][0]
    x0, y0, x1, y1 = seen.boxes[0]
    assert bbox["coordinate_system"] == "cam1"
    np.testing.assert_allclose(bbox["val"], [(x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0])


def test_every_file_is_valid_by_the_schema_of_asam_and_consistent(tmp_path: Path) -> None:
    checker = pytest.importorskip("openlabel_checker", reason="openlabel-checker is not installed")
    paths = [*OpenLabel().write(content(), tmp_path), *OpenLabel().write(Content(rig=corner_rig(1)), tmp_path)]
    assert len(paths) == 5
    for path in paths:
        outcomes = checker.check_file(str(path)).outcomes
        assert len(outcomes) > 5
        assert [issue for outcome in outcomes for issue in outcome.issues] == []


#: A turned and shifted lidar at the TUM's intersection, in the layout of its data sets: a file a frame, UUIDs, one
#: cuboid where the standard has a list, and no coordinate system but in the name of the point cloud.
LIDAR_POSE = SE3(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([10.0, 20.0, 8.0]))
UUID = "4c5e3a6b-7a37-4b2c-8c59-bf23c6f0a9d1"


def tum_traffic(second: float = 1651673050.007, **changes: Any) -> dict[str, Any]:
    cuboid = {
        "name": "shape3D",
        "val": [5.0, 1.0, -7.2, 0.0, 0.0, np.sin(0.1), np.cos(0.1), 4.5, 1.9, 1.6],
        "attributes": {
            "text": [{"name": "body_color", "val": "gray"}, {"name": "occlusion_level", "val": "NOT_OCCLUDED"}],
            "num": [{"name": "num_points", "val": 33}],
            "boolean": [],
            "vec": [],
        },
    }
    return {
        "openlabel": {
            "metadata": {"schema_version": "1.0.0"},
            "coordinate_systems": {
                "s110_base": {"type": "scene_cs", "parent": "", "children": ["s110_lidar_ouster_south"]},
                "s110_lidar_ouster_south": {
                    "type": "sensor_cs",
                    "parent": "s110_base",
                    "children": [],
                    "pose_wrt_parent": {"matrix4x4": LIDAR_POSE.matrix.ravel().tolist()},
                },
            },
            "frames": {
                "12": {
                    "frame_properties": {
                        "timestamp": second,
                        "point_cloud_file_names": ["1651673050_007_s110_lidar_ouster_south.pcd"],
                    },
                    "objects": {
                        UUID: {"object_data": {"name": "CAR_4c5e3a6b", "type": "CAR", "cuboid": cuboid}},
                        **changes.get("objects", {}),
                    },
                }
            },
        }
    }


def test_tum_traffic_s_cuboids_are_brought_from_the_lidar_to_the_root(tmp_path: Path) -> None:
    for number, second in enumerate((1651673050.007, 1651673050.107)):
        (tmp_path / f"{number}.json").write_text(json.dumps(tum_traffic(second)))
    first, second_frame = OpenLabel().read(tmp_path).boxes_3d or ()
    # a quarter turn: 5 m ahead of the lidar is 5 m along the root's Y
    np.testing.assert_allclose(first.boxes, [[9.0, 25.0, 0.8, 4.5, 1.9, 1.6, np.pi / 2 + 0.2]])
    assert (first.time_ns, second_frame.time_ns) == (1651673050007000000, 1651673050107000000)
    assert first.ids.tolist() == second_frame.ids.tolist() == [0]
    assert first.classes.tolist() == [RoadUserClass.CAR.number]


def test_what_is_no_road_user_of_ours_is_left_out_and_noted(tmp_path: Path) -> None:
    cuboid = {"name": "shape3D", "val": [0, 0, 0, 0, 0, 0, 1, 9, 2, 3]}
    other = {"x": {"object_data": {"type": "TRAILER", "cuboid": cuboid}}}
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(tum_traffic(objects=other)))
    read = OpenLabel().read(path)
    assert len((read.boxes_3d or ())[0]) == 1
    assert read.notes == ("1 boxes of type 'TRAILER' are left out.",)


def test_nine_numbers_are_euler_angles_and_keypoints_do_no_harm(tmp_path: Path) -> None:
    turned = {
        "7": {
            "object_data": {
                "type": "BUS",
                "cuboid": [
                    {"name": "shape3D", "val": [0, 0, 0, 0, 0, 0.5, 12, 2.5, 3], "coordinate_system": "s110_base"}
                ],
                "keypoints_2d": {"name": "keypoints_2d", "attributes": {}},
            }
        }
    }
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(tum_traffic(objects=turned)))
    (vehicles,) = OpenLabel().read(path).boxes_3d or ()
    np.testing.assert_allclose(vehicles.boxes[1], [0, 0, 0, 12, 2.5, 3, 0.5], atol=1e-12)


def test_the_cameras_of_a_real_intersection_survive(assets: Path, tmp_path: Path) -> None:
    cameras = {}
    for path in sorted((assets / "calibrations" / "tumtraf_s110").glob("*.json")):
        given = json.loads(path.read_text())
        T_cam_world = SE3(np.array(given["rotation_matrix"]), np.array(given["translation_matrix"]))
        cameras[path.stem] = Camera(
            np.array(given["intrinsic_camera_matrix"]),
            np.array(given["dist_coefficients"]),
            T_cam_world.inverse(),
            given["image_width"],
            given["image_height"],
        )
    read = through(tmp_path, Content(rig=CameraRig(cameras))).rig
    assert read is not None and len(read) == 4
    ground = np.array([[5.0, 5.0, 0.0], [20.0, -3.0, 0.0]])
    for camera_id, camera in cameras.items():
        np.testing.assert_allclose(read[camera_id].project(ground)[0], camera.project(ground)[0], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.pop("frames") and s.update(frames=[]), r"scene.json: openlabel.frames: "),
        (lambda s: s["frames"]["12"]["frame_properties"].pop("timestamp"), r"frames.12.frame_properties.timestamp"),
        (lambda s: s["frames"]["12"]["frame_properties"].update(timestamp=1e30), "timestamp"),
        (lambda s: _car(s).pop("type"), "has no type"),
        (lambda s: _car(s)["cuboid"]["val"].__setitem__(9, 0), "size that is not positive"),
        (lambda s: _car(s)["cuboid"].update(val=[1, 2, 3]), "cuboid.0.val"),
        (lambda s: _car(s)["cuboid"]["val"].__setitem__(slice(3, 7), [0, 0, 0, 0]), "quaternion has no length"),
        (lambda s: _car(s)["cuboid"].update(coordinate_system="moon"), "coordinate_systems.moon: is named"),
        (lambda s: s["coordinate_systems"]["s110_base"].update(parent="s110_lidar_ouster_south"), "its own ancestor"),
        (lambda s: s["coordinate_systems"]["s110_lidar_ouster_south"].pop("pose_wrt_parent"), "is missing"),
        (
            lambda s: s["coordinate_systems"]["s110_lidar_ouster_south"].update(
                pose_wrt_parent={"matrix4x4": np.diag([1, 1, -1, 1.0]).ravel().tolist()}
            ),
            "mirrored",
        ),
        (lambda s: _car(s).update(bbox=[{"name": "b", "val": [1, 2, -3, 4]}]), "negative size"),
    ],
)
def test_what_cannot_be_is_refused_by_file_and_field(tmp_path: Path, change: Any, words: str) -> None:
    document = tum_traffic()
    change(document["openlabel"])
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=words) as refused:
        OpenLabel().read(path)
    assert "scene.json" in refused.value.message


def _car(scene: dict[str, Any]) -> dict[str, Any]:
    return scene["frames"]["12"]["objects"][UUID]["object_data"]


def test_two_recordings_in_one_folder_are_not_taken_for_one(tmp_path: Path) -> None:
    (path, *_) = OpenLabel().write(content(), tmp_path)
    assert path.name == "openlabel_tracks.json"
    (tmp_path / "again.json").write_text(path.read_text())
    with pytest.raises(InputError, match="two cuboids at one time"):
        OpenLabel().read(tmp_path)


def test_an_empty_folder_and_a_scene_without_cameras_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no OpenLABEL file"):
        OpenLabel().read(tmp_path)
    with pytest.raises(InputError, match="without calibration"):
        OpenLabel().write(replace(content(), rig=None), tmp_path)
