"""nuScenes results: what is written comes back as far as the format goes, and the devkit reads it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.exchange_content import content
from wibam_core.errors import InputError
from wibam_core.exchange.nuscenes import NuScenesResults
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.scene import Vehicles3D


def test_round_trip_keeps_boxes_scores_times_and_cameras(tmp_path: Path) -> None:
    of_camera = Vehicles3D.of(7, np.array([[1.0, 2, 0.8, 4, 2, 1.6, 3.0]]), scores=np.array([0.4]), camera_id="north")
    given_boxes = [*(content().boxes_3d or ()), of_camera]
    NuScenesResults().write(replace(content(), boxes_3d=given_boxes), tmp_path)
    read = NuScenesResults().read(tmp_path).boxes_3d or ()
    expected = sorted(given_boxes, key=lambda v: v.time_ns)
    assert [(v.time_ns, v.camera_id) for v in read] == [(v.time_ns, v.camera_id) for v in expected]
    for a, b in zip(read, expected, strict=True):
        np.testing.assert_allclose(a.boxes, b.boxes, atol=1e-12)
        np.testing.assert_array_equal(a.scores, b.scores)
        assert a.classes.tolist() == [0, 0, 2][: len(b)]  # nuScenes calls a van a car


def test_convention_nuscenes_boxes_are_width_length_height_and_quaternions_begin_with_w(tmp_path: Path) -> None:
    box = np.array([[1.0, 2.0, 0.75, 4.5, 1.8, 1.5, np.pi / 2]])
    (path,) = NuScenesResults().write(replace(content(), boxes_3d=[Vehicles3D.of(80, box)]), tmp_path)
    (entry,) = json.loads(path.read_text())["results"]["80"]
    assert entry["translation"] == [1.0, 2.0, 0.75]
    assert entry["size"] == [1.8, 4.5, 1.5]
    np.testing.assert_allclose(entry["rotation"], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])


def test_velocities_are_those_of_the_tracks(tmp_path: Path) -> None:
    (path,) = NuScenesResults().write(content(), tmp_path)
    entries = json.loads(path.read_text())["results"]["0"]
    assert [entry["velocity"] for entry in entries] == [[10.0, 0.0], [-6.25, 6.25], [0.0, 0.0]]


def test_of_more_boxes_than_the_devkit_takes_the_surest_are_written(tmp_path: Path) -> None:
    boxes = np.tile([0.0, 0, 0.75, 4, 2, 1.5, 0], (600, 1))
    many = Vehicles3D.of(0, boxes, scores=np.linspace(0, 1, 600))
    (path,) = NuScenesResults().write(replace(content(), boxes_3d=[many]), tmp_path)
    scores = [entry["detection_score"] for entry in json.loads(path.read_text())["results"]["0"]]
    assert len(scores) == 500 and min(scores) > 99 / 600


def minimal(token: str = "80", **changes: Any) -> dict[str, Any]:
    box = {
        "sample_token": token,
        "translation": [0, 0, 1],
        "size": [2, 4, 1.5],
        "rotation": [1, 0, 0, 0],
        "velocity": [0, 0],
        "detection_name": "car",
        "detection_score": 0.5,
        "attribute_name": "",
    }
    return {"meta": {}, "results": {token: [box | changes]}}


def read(folder: Path, document: object) -> list[Vehicles3D]:
    path = folder / "theirs.json"
    path.write_text(json.dumps(document))
    return list(NuScenesResults().read(path).boxes_3d or ())


@given(
    yaw=st.floats(-3.1, 3.1),
    tilt=st.floats(-0.5, 0.5),
    about=st.floats(-3.1, 3.1),
    scale=st.floats(0.1, 10),
)
def test_a_tilted_box_keeps_the_heading_of_its_front_on_the_ground(
    tmp_path_factory: pytest.TempPathFactory, yaw: float, tilt: float, about: float, scale: float
) -> None:
    # its own roll and pitch, then the yaw; the oracle turns the x axis by matrices
    c, s = np.cos(tilt / 2), np.sin(tilt / 2)
    axis = np.array([np.cos(about), np.sin(about), 0.0])
    qa = np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
    qb = np.array([c, *(s * axis)])
    q = np.array([qa[0] * qb[0] - qa[1:] @ qb[1:], *(qa[0] * qb[1:] + qb[0] * qa[1:] + np.cross(qa[1:], qb[1:]))])
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + np.sin(tilt) * K + (1 - np.cos(tilt)) * K @ K
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    front = about_z @ turn @ [1, 0, 0]
    (found,) = read(tmp_path_factory.mktemp("q"), minimal(rotation=(scale * q).tolist()))
    assert normalise_angle(found.boxes[0, 6] - np.arctan2(front[1], front[0])) == pytest.approx(0, abs=1e-9)


def test_classes_that_are_no_road_users_are_left_out_and_noted(tmp_path: Path) -> None:
    path = tmp_path / "theirs.json"
    path.write_text(json.dumps(minimal(detection_name="traffic_cone")))
    found = NuScenesResults().read(path)
    assert found.notes == ("1 boxes of class 'traffic_cone' were left out",)
    assert [len(v) for v in found.boxes_3d or ()] == [0]


@pytest.mark.parametrize(
    "document",
    [
        minimal("ca9a282c9e77460f8360f564131a8af5"),
        minimal(size=[2, 0, 1]),
        minimal(rotation=[0, 0, 0, 0]),
        minimal(detection_score=1.5),
        minimal(translation=[0, 0]),
        {"results": []},
        {},
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, document: object) -> None:
    with pytest.raises(InputError, match=r"theirs\.json: results") as refused:
        read(tmp_path, document)
    assert refused.value.hint
