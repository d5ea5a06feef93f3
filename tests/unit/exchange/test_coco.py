"""COCO: what is written comes back, and COCO's own program reads it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.exchange_content import assert_same_instants, content
from wibam_core.errors import InputError
from wibam_core.exchange.base import Content
from wibam_core.exchange.coco import Coco
from wibam_core.scene import AnnotatedInstant, Detections2D


def written(folder: Path, given: Content) -> Path:
    (path,) = Coco().write(given, folder)
    return path


def test_round_trip_keeps_boxes_cameras_times_and_identities(tmp_path: Path) -> None:
    given = content()
    read = Coco().read(written(tmp_path, given))
    assert given.instants is not None and read.instants is not None
    assert_same_instants(list(read.instants), list(given.instants))
    assert read.notes == ()


def test_a_frame_without_a_box_comes_back_as_one(tmp_path: Path) -> None:
    empty = Detections2D("cam2", 5, np.empty((0, 4)), np.empty(0), np.empty(0, np.int64))
    given = replace(content(), instants=[AnnotatedInstant(0, {"cam2": empty})])
    (instant,) = Coco().read(written(tmp_path, given)).instants or ()
    assert len(instant.detections["cam2"]) == 0


def test_coco_s_own_program_reads_images_boxes_and_areas(tmp_path: Path) -> None:
    coco_program = pytest.importorskip("pycocotools.coco", reason="pycocotools is not installed")
    given = content()
    coco = coco_program.COCO(str(written(tmp_path, given)))
    instants = given.instants or ()
    assert len(coco.getImgIds()) == sum(len(instant.detections) for instant in instants)
    names = {category["id"]: category["name"] for category in coco.loadCats(coco.getCatIds())}
    assert {k: names[k] for k in (3, 6, 8)} == {3: "car", 6: "bus", 8: "truck"}  # COCO's own numbers
    seen = instants[0].detections["cam1"]
    annotations = coco.loadAnns(coco.getAnnIds(imgIds=[1]))
    boxes = np.array([a["bbox"] for a in annotations])
    np.testing.assert_allclose(boxes[:, 2:], seen.boxes[:, 2:] - seen.boxes[:, :2])
    np.testing.assert_allclose([a["area"] for a in annotations], boxes[:, 2] * boxes[:, 3])


def test_coco_s_own_program_scores_the_boxes_against_themselves_as_perfect(tmp_path: Path) -> None:
    coco_program = pytest.importorskip("pycocotools.coco", reason="pycocotools is not installed")
    evaluation = pytest.importorskip("pycocotools.cocoeval", reason="pycocotools is not installed")
    path = written(tmp_path, content())
    truth = coco_program.COCO(str(path))
    results = json.loads(path.read_text())["annotations"]
    run = evaluation.COCOeval(truth, truth.loadRes(results), "bbox")
    run.evaluate()
    run.accumulate()
    run.summarize()
    assert run.stats[0] == pytest.approx(1.0)


def test_convention_coco_pixels_begin_at_the_corner_of_the_image(tmp_path: Path) -> None:
    whole = Detections2D("cam1", 0, np.array([[-0.5, -0.5, 639.5, 359.5]]), np.ones(1), np.zeros(1, np.int64))
    path = written(tmp_path, replace(content(), instants=[AnnotatedInstant(0, {"cam1": whole})]))
    assert json.loads(path.read_text())["annotations"][0]["bbox"] == [0.0, 0.0, 640.0, 360.0]


def minimal(**changes: Any) -> dict[str, Any]:
    image = {"id": 7, "file_name": "images/north/80000000.jpg", "width": 640, "height": 360}
    return {
        "images": [image],
        "categories": [{"id": 3, "name": "car"}, {"id": 10, "name": "traffic light"}],
        "annotations": [{"id": 1, "image_id": 7, "category_id": 3, "bbox": [10, 20, 30, 40]}],
    } | changes


def read(folder: Path, document: object) -> Content:
    path = folder / "theirs.json"
    path.write_text(json.dumps(document))
    return Coco().read(path)


def test_names_of_images_say_whose_they_are_where_no_field_does(tmp_path: Path) -> None:
    (instant,) = read(tmp_path, minimal()).instants or ()
    assert instant.time_ns == 80_000_000
    assert instant.detections["north"].boxes.tolist() == [[9.5, 19.5, 39.5, 59.5]]


def test_categories_that_are_no_road_users_are_left_out_and_noted(tmp_path: Path) -> None:
    lamp = {"id": 2, "image_id": 7, "category_id": 10, "bbox": [0, 0, 5, 9]}
    found = read(tmp_path, minimal(annotations=[lamp]))
    assert found.notes == ("1 boxes of category 'traffic light' were left out",)
    assert [len(d) for instant in found.instants or () for d in instant.detections.values()] == [0]


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"images": [{"id": 7, "file_name": "0001.jpg"}]}, "images.0"),
        ({"annotations": [{"image_id": 8, "category_id": 3, "bbox": [0, 0, 1, 1]}]}, "annotations.0.image_id"),
        ({"annotations": [{"image_id": 7, "category_id": 4, "bbox": [0, 0, 1, 1]}]}, "annotations.0.category_id"),
        ({"annotations": [{"image_id": 7, "category_id": 3, "bbox": [0, 0, -1, 1]}]}, "annotations.0.bbox"),
        ({"annotations": [{"image_id": 7, "category_id": 3, "bbox": [0, 0, 1]}]}, "annotations.0.bbox.3"),
        ({"annotations": "none"}, "annotations"),
    ],
)
def test_what_cannot_be_is_refused_by_file_and_field(tmp_path: Path, changes: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError, match=r"theirs\.json") as refused:
        read(tmp_path, minimal(**changes))
    assert refused.value.details["field"] == field
    assert refused.value.hint


def test_what_is_no_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "theirs.json").write_bytes(b"\xff\xfe nothing")
    with pytest.raises(InputError, match=r"theirs\.json"):
        Coco().read(tmp_path / "theirs.json")
