"""The stage that looks for road users, on stored frames and on real footage."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.unit.stages.reading import Run, S, site
from wibam_core.artifacts import catalogue
from wibam_core.clocks import ClockMap
from wibam_core.config import DetectConfig
from wibam_core.detection.boxes import Found
from wibam_core.formats.framestore import FrameStoreWriter
from wibam_core.road_users import RoadUserClass
from wibam_core.stages import detect


class BrightSpots:
    """Finds the bright blob of an image, as a truck."""

    classes = (RoadUserClass.CAR, RoadUserClass.VAN, RoadUserClass.TRUCK, RoadUserClass.BUS)

    def detect(self, image_bgr: np.ndarray) -> Found:
        rows, columns = np.nonzero(image_bgr[..., 0] > 200)
        if not len(rows):
            return Found(np.empty((0, 4)), np.empty(0), np.empty(0, np.int64))
        box = np.array([[columns.min() - 0.5, rows.min() - 0.5, columns.max() + 0.5, rows.max() + 0.5]])
        return Found(box, np.array([0.75]), np.array([2]))


def stored(root: Path, spots: bool) -> Run:
    """Frames of 64x36 px of a 128x72 px recording; camera a has a spot that moves, b has none."""
    run = Run(root, {"a": root, "b": root})
    with FrameStoreWriter(run.place(catalogue.FRAMES), 95) as writer:
        for i in range(40):
            image = np.zeros((36, 64, 3), np.uint8)
            if spots:
                image[8:16, i : i + 16] = 255
            writer.add("a", i * S, i * S + 3, image)
            if i % 2:
                writer.add("b", i * S, i * S - 2, np.zeros((36, 64, 3), np.uint8))
        writer.close({"a": (128, 72), "b": (128, 72)})
    run.give(catalogue.TIMESTAMPS, {"a": np.arange(40) * S + 3, "b": np.arange(1, 40, 2) * S - 2})
    return run


def test_convention_detections_are_in_pixels_of_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detect, "load_detector", lambda path, **options: BrightSpots())
    run = stored(tmp_path, spots=True)
    seen: list[float] = []
    context = run.of("detect", progress=lambda fraction, message="", **figures: seen.append(fraction))
    summary = detect.run(context, DetectConfig(refine="off"))
    instants = run.detected()
    assert [instant.time_ns for instant in instants] == [i * S for i in range(40)]
    for i, instant in enumerate(instants):
        assert set(instant.detections) == ({"a", "b"} if i % 2 else {"a"})
        found = instant.detections["a"]
        assert found.frame_time_ns == i * S + 3
        assert np.allclose(found.boxes, [[2 * i - 0.5, 15.5, 2 * i + 31.5, 31.5]], atol=2.1)
        assert found.classes.tolist() == [2]
        assert instant.vehicles == ()
    assert len(instants[1].detections["b"]) == 0
    assert run.read(catalogue.DETECTION_STATISTICS).model_dump() == summary
    assert summary["boxes_by_camera"] == {"a": 40, "b": 0}
    assert summary["boxes_by_class"] == {"car": 0, "van": 0, "truck": 40, "bus": 0}
    assert summary["unknown_classes"] == ["motorcycle", "bicycle", "pedestrian"]
    assert summary["frames"] == 60
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    json.dumps(summary)


def test_vehicles_are_looked_for_as_often_as_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detect, "load_detector", lambda path, **options: BrightSpots())
    run = stored(tmp_path, spots=True)
    summary = detect.run(run.of("detect"), DetectConfig(refine="off", rate_hz=0.25))
    instants = run.detected()
    assert [instant.time_ns for instant in instants] == [i * S for i in range(0, 40, 4)]
    assert summary["frames"] == 10


def test_no_vehicle_at_all_is_left_to_the_stages_after(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detect, "load_detector", lambda path, **options: BrightSpots())
    run = stored(tmp_path, spots=False)
    summary = detect.run(run.of("detect"), DetectConfig())
    assert summary["boxes_by_camera"] == {"a": 0, "b": 0} and len(run.detected()) == 40


@pytest.mark.assets
def test_custom_detector_runs_on_real_footage(assets: Path, tmp_path: Path) -> None:
    run = Run(tmp_path, {"a": assets / "footage" / "traffic.mp4"})
    run.site = site(("a",), 640, 360)
    run.preflight()
    run.frames({"a": ClockMap()}, rate_hz=0.5)
    context = run.of("detect", assets={"detector": assets / "detectors" / "yolox_nano.onnx"})
    summary = detect.run(context, DetectConfig(detector="custom", min_score=0.2))
    assert summary["frames"] == 10
    assert summary["boxes"] >= 20
    for instant in run.detected():
        assert len(instant.detections["a"])
