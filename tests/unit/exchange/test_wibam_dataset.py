"""The published WIBAM data set: a folder of its layout goes in and out, and its conventions are pinned."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.builders import corner_rig
from tests.exchange_content import PERIOD_NS, boxes_at, content
from wibam_core.errors import InputError
from wibam_core.exchange.base import Content, Part
from wibam_core.exchange.wibam.dataset import WibamDataset
from wibam_core.geometry.projection import project_boxes
from wibam_core.geometry.se3 import normalise_angle


def jpeg(camera_id: str, frame_time_ns: int) -> bytes:
    """A flat image that tells cameras and times apart."""
    grey = 40 * int(camera_id[-1]) + frame_time_ns // PERIOD_NS
    return cv2.imencode(".jpg", np.full((360, 640, 3), grey, np.uint8))[1].tobytes()


def whole() -> Content:
    times = [step * PERIOD_NS for step in range(5)]
    return replace(content(), jpeg=jpeg, splits={"train": times[:3], "val": times[3:4], "test": times[4:]})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    list(WibamDataset().write(whole(), tmp_path))
    return tmp_path / "wibam"


def read(folder: Path) -> Content:
    return WibamDataset().read(folder)


# --- there and back ----------------------------------------------------------------------------
def test_round_trip_keeps_cameras(folder: Path) -> None:
    rig, given = read(folder).rig, whole().rig
    assert rig is not None and given is not None
    assert list(rig) == ["0", "1", "2"]
    for camera, expected in zip(rig.values(), given.values(), strict=True):
        np.testing.assert_allclose(camera.K, expected.K)
        np.testing.assert_allclose(camera.T_world_cam.matrix, expected.T_world_cam.matrix, atol=1e-9)
        assert (camera.width_px, camera.height_px) == (640, 360)
    site = read(folder.parent).site
    assert site is not None and site.camera_ids == ("0", "1", "2")


def test_round_trip_keeps_boxes_and_which_of_them_show_one_vehicle(folder: Path) -> None:
    given, found = whole().instants or (), read(folder).instants or ()
    assert [instant.time_ns for instant in found] == [instant.time_ns for instant in given]
    for a, b in zip(found, given, strict=True):
        for seen, expected in zip(a.detections.values(), b.detections.values(), strict=True):
            np.testing.assert_allclose(seen.boxes, expected.boxes, atol=1e-9)
            np.testing.assert_allclose(seen.scores, expected.scores)
            assert seen.frame_time_ns == a.time_ns
        assert [v.obj_id for v in a.vehicles] == [v.obj_id for v in b.vehicles]
        for vehicle, expected_vehicle in zip(a.vehicles, b.vehicles, strict=True):
            assert list(vehicle.views.values()) == list(expected_vehicle.views.values())
            assert vehicle.track_id == -1
            assert np.hypot(vehicle.x_m - expected_vehicle.x_m, vehicle.y_m - expected_vehicle.y_m) < 1.0


def test_round_trip_keeps_labels_with_classes_from_the_image_boxes(folder: Path) -> None:
    for a, b in zip(read(folder).labels or (), whole().labels or (), strict=True):
        assert a.vehicles.time_ns == b.vehicles.time_ns
        np.testing.assert_allclose(a.vehicles.boxes, b.vehicles.boxes, atol=1e-9)
        assert a.vehicles.classes.tolist() == [0, 0, 2]  # nuScenes calls a van a car
        assert [shares.tolist() for shares in a.visibility.values()] == [[1.0, 0.75, 0.5]] * 3


def test_round_trip_keeps_the_split_and_the_frames(folder: Path) -> None:
    found = read(folder)
    assert found.splits == whole().splits
    assert found.jpeg is not None
    assert found.jpeg("2", 3 * PERIOD_NS) == jpeg("cam3", 3 * PERIOD_NS)
    assert Part.FRAMES in found.parts


def test_ids_of_one_instant_follow_each_other_over_the_cameras(folder: Path) -> None:
    images = json.loads((folder / "annotations/wibam_all.json").read_text())["images"]
    assert [(i["id"], i["cam"], i["file_name"]) for i in images[3:6]] == [
        (3, 0, "0/1.jpg"),
        (4, 1, "1/1.jpg"),
        (5, 2, "2/1.jpg"),
    ]
    assert (folder / "image_sets/val.txt").read_text() == "9\n"


def test_instants_closer_than_the_data_set_s_period_are_refused(tmp_path: Path) -> None:
    instants = [replace(i, time_ns=i.time_ns // 4) for i in content().instants or ()]
    with pytest.raises(InputError, match="fall into one period"):
        list(WibamDataset().write(replace(content(), instants=instants), tmp_path))


# --- conventions -------------------------------------------------------------------------------
def test_convention_wibam_extrinsics_take_world_points_into_the_camera(folder: Path) -> None:
    rig = whole().rig
    assert rig is not None
    camera = rig["cam1"]
    with np.load(folder / "calib/calibration_0.npz") as said:
        point = np.array([1.0, 2.0, 0.5])
        pixel, _ = cv2.projectPoints(point, said["rvec"], said["tvec"], said["camera_matrix"], said["dist_coefs"])
        # the optical axis over the ground, counter-clockwise from X: from (15.6, 15.6) towards the middle
        assert float(said["theta_X_d"]) == pytest.approx(-135.0)
    np.testing.assert_allclose(pixel.ravel(), camera.project(point)[0])


def test_convention_wibam_image_boxes_begin_at_the_corner_of_the_image(folder: Path) -> None:
    document = json.loads((folder / "annotations/wibam_all.json").read_text())
    seen = (whole().instants or ())[0].detections["cam1"]
    x, y, width, height = document["annotations"][0]["bbox"]
    np.testing.assert_allclose([x - 0.5, y - 0.5, x - 0.5 + width, y - 0.5 + height], seen.boxes[0])


def test_convention_wibam_labels_turn_counter_clockwise_and_stand_on_their_bottom(folder: Path) -> None:
    objects = json.loads((folder / "annotations/hand_labels/0/0.json").read_text())
    for i, box in enumerate(boxes_at(0)):
        written = objects[str(i)]
        np.testing.assert_allclose(written["location"], [box[0], box[1], box[2] - box[5] / 2])
        assert written["size"] == box[3:6].tolist()  # length, width, height
        assert written["rot"] == pytest.approx(box[6])
        assert len(written["visibility"]) == 3  # one for each camera


def rewrite_labels(folder: Path, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    for path in (folder / "annotations/hand_labels").rglob("*.json"):
        objects = json.loads(path.read_text())
        path.write_text(json.dumps({name: change(given) for name, given in objects.items()}))


def well_seen(given: dict[str, Any]) -> dict[str, Any]:
    return given | {"visibility": [1.0, 1.0, 1.0]}


def at_half_height(given: dict[str, Any]) -> dict[str, Any]:
    x, y, z = given["location"]
    return given | {"location": [x, y, z + given["size"][2] / 2]}


def in_degrees(given: dict[str, Any]) -> dict[str, Any]:
    return given | {"rot": float(np.degrees(given["rot"])) % 360}


def in_single_letters(given: dict[str, Any]) -> dict[str, Any]:
    named = dict(zip("xyzlwh", [*given["location"], *given["size"]], strict=True))
    return {"rot": given["rot"], "visibility": given["visibility"], "current": True} | named


@pytest.mark.parametrize("centre", [None, at_half_height], ids=["bottom", "half height"])
@pytest.mark.parametrize("unit", [None, in_degrees], ids=["radians", "degrees"])
@pytest.mark.parametrize("names", [None, in_single_letters], ids=["words", "letters"])
def test_convention_wibam_labels_are_read_as_they_reproject_best(folder: Path, centre, unit, names) -> None:
    for change in (well_seen, centre, unit, names):
        if change is not None:
            rewrite_labels(folder, change)
    found = read(folder)
    for instant, step in zip(found.labels or (), range(5), strict=True):
        difference = instant.vehicles.boxes - boxes_at(step)
        difference[:, 6] = normalise_angle(difference[:, 6])
        np.testing.assert_allclose(difference, 0, atol=1e-9)
    assert f"in {'radians' if unit is None else 'degrees'}" in found.notes[-1].split(":")[0]
    assert f"middle of the {'bottom' if centre is None else 'box'}" in found.notes[-1].split(":")[0]
    assert "by 1.000 on average, against 0." in found.notes[-1]


def test_without_a_2d_box_labels_are_read_as_the_published_program_draws_them(folder: Path) -> None:
    file = folder / "annotations/wibam_all.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"annotations": []}))
    found = read(folder)
    np.testing.assert_allclose((found.labels or ())[0].vehicles.boxes, boxes_at(0), atol=1e-9)
    assert "no 2D box decides" in found.notes[-1]
    assert "radians" in found.notes[-1] and "bottom" in found.notes[-1]


def test_image_boxes_are_what_labels_reproject_onto() -> None:
    """The oracle of the tests above: at half a height off, boxes of elevated cameras overlap far less."""
    camera = corner_rig(3)["cam1"]
    shifted = boxes_at(0) + [0, 0, 0.75, 0, 0, 0, 0]
    assert np.abs(project_boxes(camera, shifted) - project_boxes(camera, boxes_at(0)))[:, [1, 3]].min() > 5


# --- what others' files may hold ---------------------------------------------------------------
def test_numbers_of_opencv_s_columns_and_missing_sizes_are_taken(folder: Path) -> None:
    file = folder / "annotations/wibam_all.json"
    document = json.loads(file.read_text())
    for image in document["images"]:
        image |= {"rvec": [[v] for v in image["rvec"]], "tvec": [image["tvec"]]}
        del image["width"], image["height"]
    del document["categories"]
    file.write_text(json.dumps(document))
    rig = read(folder).rig
    assert rig is not None and rig["1"].width_px == 640  # of the frame
    for path in (folder / "calib").iterdir():
        path.unlink()
    (folder / "calib").rmdir()
    (folder / "frames").rename(folder / "elsewhere")
    found = read(folder)
    assert found.jpeg is None and found.rig is not None
    assert (found.rig["1"].width_px, found.rig["1"].height_px) == (1920, 1080)  # the published frames'


def test_an_empty_label_file_is_an_instant_without_a_vehicle(folder: Path) -> None:
    for path in (folder / "annotations/hand_labels").rglob("4.json"):
        path.write_text("{}")
    last = (read(folder).labels or ())[-1]
    assert last.vehicles.time_ns == 4 * PERIOD_NS and len(last.vehicles) == 0


def test_labels_of_some_cameras_and_of_unknown_frames_are_noted(folder: Path) -> None:
    labels = folder / "annotations/hand_labels"
    (labels / "1/4.json").rename(labels / "1/77.json")
    notes = " ".join(read(folder).notes)
    assert "hand labels of 1 frames that are no images" in notes
    assert "1 of 5 labelled instants are labelled in some of the cameras only" in notes


def test_steps_of_the_frame_numbers_are_noted(tmp_path: Path) -> None:
    every_other = [replace(i, time_ns=2 * i.time_ns) for i in content().instants or ()]
    list(WibamDataset().write(replace(content(), instants=every_other, labels=None), tmp_path))
    found = read(tmp_path)
    assert [i.time_ns // PERIOD_NS for i in found.instants or ()] == [0, 2, 4, 6, 8]
    assert found.notes == ("frames are numbered in steps of 2, taken as 160 ms apart",)


def in_document(change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        file = folder / "annotations/wibam_all.json"
        document = json.loads(file.read_text())
        change(document)
        file.write_text(json.dumps(document))

    return apply


def in_file(name: str, text: str | bytes) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes(text.encode() if isinstance(text, str) else text) and None


def pickled(folder: Path) -> None:
    np.savez(
        folder / "calib/calibration_0.npz",
        camera_matrix=np.array([{}], dtype=object),
        dist_coefs=np.zeros(0),
        rvec=np.zeros(3),
        tvec=np.zeros(3),
    )


def inflated(folder: Path) -> None:
    np.savez_compressed(folder / "calib/calibration_0.npz", camera_matrix=np.zeros(1 << 20))


@pytest.mark.parametrize(
    ("damage", "problem"),
    [
        (in_document(lambda d: d["images"][0].update(file_name="../../secret/0.jpg")), "leads out of the folder"),
        (in_document(lambda d: d["images"][0].update(file_name="/etc/0.jpg")), "leads out of the folder"),
        (in_document(lambda d: d["images"][0].update(file_name="0/first.jpg")), "images.0.file_name"),
        (in_document(lambda d: d["images"][1].update(id=0, cam=0)), "two images of one instant"),
        (in_document(lambda d: d["images"][0].update(cam=32)), "images.0.cam"),
        (in_document(lambda d: d["images"][0].update(P=[[1, 2], [3, 4]])), "images.0.P"),
        (in_document(lambda d: d["annotations"][0].update(image_id=99)), "annotations.0.image_id"),
        (in_document(lambda d: d["annotations"][0].update(category_id=99)), "annotations.0.category_id"),
        (in_document(lambda d: d["annotations"][0].update(bbox=[0, 0, -1, 1])), "annotations.0.bbox"),
        (in_document(lambda d: d.update(images=[])), "images"),
        (in_file("image_sets/val.txt", "77\n"), "val.txt: line 1: '77' is the id of no image"),
        (in_file("image_sets/val.txt", "first\n"), "val.txt: line 1"),
        (in_file("calib/calibration_0.npz", b"nothing"), "calibration_0.npz: arrays"),
        (pickled, "calibration_0.npz: arrays"),
        (inflated, "calibration_0.npz: arrays: more than"),
        (in_file("annotations/hand_labels/0/0.json", "[1]"), "0.json"),
        (in_file("annotations/hand_labels/0/first.json", "{}"), "first.json: name"),
        (lambda f: rewrite_labels(f, lambda g: g | {"visibility": [0.5]}), "visibility"),
        (lambda f: rewrite_labels(f, lambda g: g | {"visibility": [2, 2, 2]}), "visibility"),
        (lambda f: rewrite_labels(f, lambda g: g | {"size": [4, 2, 0]}), "size"),
        (lambda f: rewrite_labels(f, lambda g: g | {"rot": "north"}), "rot"),
    ],
)
def test_what_cannot_be_is_refused_by_file_and_field(
    folder: Path, damage: Callable[[Path], None], problem: str
) -> None:
    damage(folder)
    with pytest.raises(InputError, match=problem) as refused:
        read(folder)
    assert refused.value.hint


def test_a_frame_that_is_a_link_out_of_the_folder_is_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(b"secret")
    frame = folder / "frames/0/0.jpg"
    frame.unlink()
    frame.symlink_to(tmp_path / "secret")
    with pytest.raises(InputError, match="leads out of the folder"):
        read(folder)
