"""Decoding, on tiny ONNX networks that give a known output whatever they see."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from wibam_core.detection.centre import CentreDetector
from wibam_core.detection.detector import load_detector
from wibam_core.detection.yolox import YoloxDetector, letterbox
from wibam_core.errors import InvalidWeights
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.road_users import RoadUserClass
from wibam_core.video.decode import decode

CAR, VAN, TRUCK, BUS = range(4)
PEDESTRIAN = RoadUserClass.PEDESTRIAN.number


def save(
    path: Path,
    input_name: str,
    input_shape: list[int | str],
    outputs: dict[str, np.ndarray],
    metadata: dict[str, str] | None = None,
    mirrored: str | None = None,
) -> Path:
    """A network whose outputs are constants, but for the one that mirrors its input."""
    values = [numpy_helper.from_array(array.astype(np.float32), f"{name}_value") for name, array in outputs.items()]
    nodes = [
        helper.make_node("Identity", [input_name if name == mirrored else f"{name}_value"], [name]) for name in outputs
    ]
    graph = helper.make_graph(
        nodes,
        "constant",
        [helper.make_tensor_value_info(input_name, TensorProto.FLOAT, input_shape)],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, array.shape) for name, array in outputs.items()],
        values,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    helper.set_model_props(model, metadata or {})
    onnx.save(model, str(path))
    return path


def centre_model(path: Path, peaks: list[tuple[int, int, int, float, list[float]]], rows: int = 96) -> Path:
    """Peaks: class, row, column, heat, distances in cells."""
    heat, ltrb = np.zeros((1, 4, rows, 160)), np.ones((1, 4, rows, 160))
    for number, row, column, score, sides in peaks:
        heat[0, number, row, column] = score
        ltrb[0, :, row, column] = sides
    metadata = {"family": "wibam-centre", "classes": json.dumps(["car", "van", "truck", "bus"])}
    return save(path, "image", [1, 3, "height", "width"], {"heat": heat, "ltrb": ltrb}, metadata)


def yolox_model(path: Path, cells: dict[int, tuple[list[float], float, dict[int, float]]], size: int = 64) -> Path:
    """Cells: index -> raw box, objectness, probability by COCO class."""
    count = sum((size // stride) ** 2 for stride in (8, 16, 32))
    output = np.zeros((1, count, 85))
    for index, (raw, objectness, classes) in cells.items():
        output[0, index, :4], output[0, index, 4] = raw, objectness
        for coco, probability in classes.items():
            output[0, index, 5 + coco] = probability
    return save(path, "images", [1, 3, size, size], {"output": output})


def image(width: int, height: int) -> np.ndarray:
    return np.full((height, width, 3), 128, np.uint8)


def test_convention_centre_boxes_at_the_networks_own_size(tmp_path: Path) -> None:
    path = centre_model(tmp_path / "a.onnx", [(TRUCK, 20, 30, 0.9, [5, 3, 4, 2])])
    found = load_detector(path, min_score=0.3, nms_iou=0.6).detect(image(640, 384))
    centre = np.array([30.5 * 4 - 0.5, 20.5 * 4 - 0.5])
    expected = [*(centre - 4 * np.array([5, 3])), *(centre + 4 * np.array([4, 2]))]
    assert np.allclose(found.boxes, [expected])
    assert found.scores == pytest.approx([0.9])
    assert found.classes.tolist() == [TRUCK]


@pytest.mark.parametrize(
    ("width", "height", "rows"), [(1280, 720, 96), (512, 288, 96), (640, 480, 120), (1920, 1080, 96)]
)
def test_convention_centre_boxes_are_in_the_pixels_of_the_image(
    tmp_path: Path, width: int, height: int, rows: int
) -> None:
    path = centre_model(tmp_path / "a.onnx", [(BUS, 20, 30, 0.9, [5, 3, 4, 2])], rows)
    found = load_detector(path, min_score=0.3, nms_iou=0.6).detect(image(width, height))
    at_640 = np.array([30.5 * 4 - 0.5 - 20, 20.5 * 4 - 0.5 - 12, 30.5 * 4 - 0.5 + 16, 20.5 * 4 - 0.5 + 8])
    assert np.allclose(found.boxes[0], (at_640 + 0.5) * width / 640 - 0.5)


def test_centre_input_is_bgr_in_0_to_1_padded_to_32_rows(tmp_path: Path) -> None:
    """The heat is the input itself, 320 rows of it for 300 of the image: a blue pixel is a peak of the first class."""
    outputs = {"heat": np.zeros((1, 3, 320, 640)), "ltrb": np.ones((1, 4, 320, 640))}
    metadata = {"family": "wibam-centre", "classes": json.dumps(["bus", "car", "van"])}
    path = save(tmp_path / "a.onnx", "image", [1, 3, 320, 640], outputs, metadata, mirrored="heat")
    shown = np.zeros((300, 640, 3), np.uint8)
    shown[70, 100] = (255, 51, 0)
    shown[40, 50] = (0, 102, 0)
    found = load_detector(path, min_score=0.1, nms_iou=0.5).detect(shown)
    assert found.scores == pytest.approx([1.0, 0.4])
    assert found.classes.tolist() == [BUS, CAR]  # by the network's own names
    assert np.allclose(found.boxes[0, :2], [100.5 * 4 - 4.5, 70.5 * 4 - 4.5])


def test_one_vehicle_is_one_box_whatever_its_classes(tmp_path: Path) -> None:
    peaks = [
        (CAR, 20, 30, 0.5, [5, 3, 4, 2]),
        (VAN, 20, 30, 0.8, [5, 3, 4, 2]),
        (CAR, 50, 90, 0.4, [5, 3, 4, 2]),
        (CAR, 60, 10, 0.2, [5, 3, 4, 2]),
    ]
    path = centre_model(tmp_path / "a.onnx", peaks)
    found = load_detector(path, min_score=0.3, nms_iou=0.6).detect(image(640, 384))
    assert found.classes.tolist() == [VAN, CAR]
    assert found.scores == pytest.approx([0.8, 0.4])


def test_nothing_found_is_empty_arrays(tmp_path: Path) -> None:
    for path, size in (
        (centre_model(tmp_path / "a.onnx", []), (640, 384)),
        (yolox_model(tmp_path / "b.onnx", {}), (64, 64)),
    ):
        found = load_detector(path, min_score=0.3, nms_iou=0.6).detect(image(*size))
        assert (found.boxes.shape, found.scores.shape, found.classes.shape) == ((0, 4), (0,), (0,))


@pytest.mark.parametrize(("width", "height"), [(64, 64), (128, 72), (200, 400)])
def test_convention_yolox_cells_and_letterbox(tmp_path: Path, width: int, height: int) -> None:
    """64x64: 64 cells of 8 px, then 16 of 16 px, then 4 of 32 px, each row by row."""
    wide = np.log([1.0, 0.5])
    cells = {
        8 * 2 + 1: ([0.5, 0.25, *wide], 0.9, {2: 1.0}),
        64 + 4 * 1 + 0: ([0.5, 0.5, *np.log([0.5, 0.25])], 0.8, {5: 1.0}),
        64 + 16 + 0: ([0.3, 0.6, *np.log([0.25, 0.25])], 0.7, {7: 1.0}),
    }
    path = yolox_model(tmp_path / "a.onnx", cells)
    detector = load_detector(path, min_score=0.3, nms_iou=0.6)
    assert isinstance(detector, YoloxDetector)
    found = detector.detect(image(width, height))
    scale = min(64 / width, 64 / height)
    centres = np.array([[1.5 * 8, 2.25 * 8], [0.5 * 16, 1.5 * 16], [0.3 * 32, 0.6 * 32]])
    halves = np.array([[4.0, 2.0], [4.0, 2.0], [4.0, 4.0]])
    at_64 = np.concatenate([centres - halves, centres + halves], axis=1)
    expected = np.clip(at_64 / scale - 0.5, -0.5, np.array([width, height] * 2) - 0.5)
    assert np.allclose(found.boxes, expected, atol=1e-5)
    assert found.classes.tolist() == [CAR, BUS, TRUCK]
    assert found.scores == pytest.approx([0.9, 0.8, 0.7])


def test_yolox_counts_what_a_vehicle_is_taken_for_and_nothing_else(tmp_path: Path) -> None:
    box = [0.5, 0.5, 0.0, 0.0]
    cells = {
        0: (box, 0.9, {15: 1.0}),  # a cat
        5: (box, 0.5, {0: 0.9, 2: 0.1}),  # a person, hardly a car
        10: (box, 0.9, {4: 0.8, 7: 0.1}),  # an aeroplane on the road, most like a truck
        20: (box, 0.8, {2: 0.5, 7: 0.5}),  # a car or a truck
        30: (box, 0.9, {2: 0.2}),
    }
    found = load_detector(yolox_model(tmp_path / "a.onnx", cells), min_score=0.3, nms_iou=0.6).detect(image(64, 64))
    assert found.scores == pytest.approx([0.9 * (1 - 0.2 * 0.9), 0.8 * 0.75, 0.5 * 0.9])
    assert found.classes.tolist() == [TRUCK, CAR, PEDESTRIAN]


def test_hostile_outputs_give_no_boxes(tmp_path: Path) -> None:
    cells = {
        0: ([np.nan] * 4, 1.0, {2: 1.0}),
        9: ([0.5, 0.5, 1e30, 0.0], 1.0, {2: 1.0}),
        18: ([0.5, 0.5, 0.0, 0.0], np.nan, {2: 1.0}),
    }
    found = load_detector(yolox_model(tmp_path / "a.onnx", cells), min_score=0.3, nms_iou=0.6).detect(image(64, 64))
    assert np.isfinite(found.boxes).all()
    assert len(found.boxes) == 1


def test_letterbox_pads_right_and_bottom_with_grey_114() -> None:
    boxed = letterbox(np.full((36, 64, 3), 10, np.uint8), 416, 416)
    assert boxed.shape == (416, 416, 3)
    assert (boxed[:234] == 10).all()
    assert (boxed[234:] == 114).all()


def test_wrong_files_are_refused_saying_what_is_expected(tmp_path: Path) -> None:
    text = tmp_path / "text.onnx"
    text.write_text("no network")
    odd = save(tmp_path / "odd.onnx", "x", [1, 3, 64, 64], {"y": np.zeros((1, 10))})
    bare = save(
        tmp_path / "bare.onnx", "image", [1, 3, 64, 64], {"heat": np.zeros((1, 4, 16, 16))}, {"family": "wibam-centre"}
    )
    alien = centre_model(tmp_path / "alien.onnx", [])
    model = onnx.load(str(alien))
    helper.set_model_props(model, {"family": "wibam-centre", "classes": '["tram"]'})
    onnx.save(model, str(alien))
    nameless = centre_model(tmp_path / "nameless.onnx", [])
    model = onnx.load(str(nameless))
    helper.set_model_props(model, {"family": "wibam-centre"})
    onnx.save(model, str(nameless))
    for path, match in {
        nameless: "does not say which classes",
        text: "no ONNX network",
        odd: r"takes x .* and gives y",
        bare: "has no ltrb",
        alien: "'tram'",
        tmp_path / "absent.onnx": "does not exist",
    }.items():
        with pytest.raises(InvalidWeights, match=match) as caught:
            load_detector(path, min_score=0.3, nms_iou=0.6)
        assert caught.value.code == "invalid_weights"
        assert "safetensors" not in caught.value.hint


def test_heat_of_a_class_without_a_name_is_refused(tmp_path: Path) -> None:
    path = centre_model(tmp_path / "a.onnx", [])
    model = onnx.load(str(path))
    helper.set_model_props(model, {"family": "wibam-centre", "classes": '["car"]'})
    onnx.save(model, str(path))
    detector = load_detector(path, min_score=0.3, nms_iou=0.6)
    with pytest.raises(InvalidWeights, match="names 1 classes and has heat for 4"):
        detector.detect(image(640, 384))


def test_kind_is_chosen_by_the_file(tmp_path: Path) -> None:
    assert isinstance(load_detector(centre_model(tmp_path / "a.onnx", []), min_score=0.3, nms_iou=0.6), CentreDetector)
    assert isinstance(load_detector(yolox_model(tmp_path / "b.onnx", {}), min_score=0.3, nms_iou=0.6), YoloxDetector)


@pytest.mark.assets
def test_real_yolox_finds_the_cars_of_a_real_frame(assets: Path) -> None:
    detector = load_detector(assets / "detectors" / "yolox_nano.onnx", min_score=0.3, nms_iou=0.6)
    frames = decode(assets / "footage" / "traffic.mp4")
    frame = next(image for number, (_, image) in enumerate(frames) if number == 120)
    found = detector.detect(frame)
    # read off the picture by eye: xyxy of four whole or nearly whole cars
    cars = np.array([[141, 146, 280, 206], [349, 217, 507, 296], [540, 144, 637, 203], [0, 213, 81, 274]])
    assert image_iou(cars.astype(float), found.boxes).max(axis=1).min() > 0.8
