"""OpenTrafficCam: the layout that OTAnalytics reads, with every box where it was seen."""

from __future__ import annotations

import bz2
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.exchange_content import content
from wibam_core.errors import InputError
from wibam_core.exchange.base import Content
from wibam_core.exchange.ottrk import Ottrk


def written(folder: Path, given: Content) -> dict[str, dict[str, Any]]:
    """What is in the file of each camera."""
    return {path.stem: json.loads(bz2.decompress(path.read_bytes())) for path in Ottrk().write(given, folder)}


def test_a_file_a_camera_with_the_boxes_that_were_linked(tmp_path: Path) -> None:
    given = content()
    documents = written(tmp_path, given)
    assert list(documents) == ["cam1", "cam2", "cam3"]
    for camera_id, document in documents.items():
        detections = document["data"]["detections"]
        expected = [
            (instant.detections[camera_id], vehicle.views[camera_id], vehicle)
            for instant in given.instants or ()
            for vehicle in instant.vehicles
            if camera_id in vehicle.views
        ]
        assert len(detections) == len(expected) > 0
        for found, (seen, index, vehicle) in zip(detections, expected, strict=True):
            x0, y0, x1, y1 = seen.boxes[index]
            # the centre of the first pixel is half a pixel from the image's corner
            assert (found["x"], found["y"]) == pytest.approx((x0 + 0.5, y0 + 0.5))
            assert (found["w"], found["h"]) == pytest.approx((x1 - x0, y1 - y0))
            assert found["occurrence"] == pytest.approx(seen.frame_time_ns / 1e9)
            assert found["track-id"] == vehicle.track_id
            assert found["class"] == {"car": "car", "van": "delivery_van"}[vehicle.vehicle_class]
            assert found["confidence"] == seen.scores[index]


def test_frames_count_from_one_and_the_ends_of_tracks_are_marked(tmp_path: Path) -> None:
    detections = written(tmp_path, content())["cam1"]["data"]["detections"]
    car = [d for d in detections if d["track-id"] == 10]
    assert [d["frame"] for d in car] == [1, 2, 3, 4, 5]
    assert [d["first"] for d in car] == [True, False, False, False, False]
    assert [d["finished"] for d in car] == [False, False, False, False, True]


def test_metadata_tell_the_size_rate_and_classes(tmp_path: Path) -> None:
    metadata = written(tmp_path, content())["cam3"]["metadata"]
    video = metadata["video"]
    assert (video["filename"], video["width"], video["height"]) == ("cam3", 640, 360)
    assert (video["recorded_fps"], video["number_of_frames"]) == (12.5, 5)
    assert "delivery_van" in metadata["detection"]["model"]["classes"].values()


def test_boxes_that_are_linked_with_nothing_are_left_out(tmp_path: Path) -> None:
    given = content()
    alone = [
        replace(instant, vehicles=tuple(replace(v, track_id=-1) for v in instant.vehicles))
        for instant in given.instants or ()
    ]
    documents = written(tmp_path, replace(given, instants=alone))
    assert all(document["data"]["detections"] == [] for document in documents.values())


def test_content_without_boxes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="without 2D boxes"):
        Ottrk().write(Content(), tmp_path)


def test_times_within_a_file_never_go_back(tmp_path: Path) -> None:
    given = content()
    shuffled = replace(given, instants=list(reversed(given.instants or ())))
    times = [d["occurrence"] for d in written(tmp_path, shuffled)["cam2"]["data"]["detections"]]
    assert times == sorted(times) and len(np.unique(times)) == 5
