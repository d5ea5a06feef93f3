"""Stage folders to the report's data, and the stage as a whole."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.builders import corner_rig, site_of
from tests.stage_folders import StageFolders
from tests.unit.report.documents import metrics_json
from tests.unit.report.scenes import boxes_at, crossing_traffic
from tests.unit.report.upstream import annotated, write_upstream
from wibam_core.artifacts import catalogue
from wibam_core.config import ReportConfig
from wibam_core.documents.metrics import Metrics
from wibam_core.report.assemble import assemble
from wibam_core.report.data import ReportData
from wibam_core.report.selection import busiest, choose_examples, stretches
from wibam_core.stages import report

TITLES = {"sync": "Synchronise", "finetune": "Fine-tune", "absent": "Not there"}


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> tuple[StageFolders, Path]:
    return write_upstream(tmp_path_factory.mktemp("stages"))


@pytest.fixture(scope="module")
def data(folders) -> ReportData:
    made, labels = folders
    return assemble("Elm Street", made.reader, labels, TITLES, examples=3)


def test_everything_is_read(data):
    assert data.site_name == "Elm Street" and len(data.rig) == 4 and len(data.recordings) == 4
    assert [row.camera_id for row in data.calibration] == list(data.rig)
    assert data.calibration[0].points == 9 and data.calibration[0].median_px == pytest.approx(0.5**0.5)
    assert (0.0, 15.0) in data.calibration[0].pixel_m or (15.0, 30.0) in data.calibration[0].pixel_m
    assert data.overlap is not None and len(data.overlap.pairs) == 6 and not data.refinement.taken
    assert list(data.dataset.subsets) == ["train", "val", "test"]
    assert [curve.name for curve in data.training.totals] == ["training", "validation"]
    assert {curve.name for curve in data.training.parts} == {"heatmap", "size"}
    assert ("images as the network sees them", "704 px wide") in data.training.facts
    assert len(data.tracks) == 6 and data.conflict_thresholds["ttc_s"] == 3.0
    assert [(row.title, row.seconds) for row in data.stages] == [("Synchronise", 1.5), ("Fine-tune", 1.5)]
    assert ("evaluate.min_score", "0.3") in data.options


def test_delays_have_the_sign_of_the_offsets(data):
    """The second camera's clock is 0.4 s behind the reference: it shows each change 0.4 s earlier."""
    delays = {d.camera_id: d for d in data.synchronisation.delays}
    assert set(delays) == {"cam2", "cam3", "cam4"}
    assert delays["cam2"].before_s == pytest.approx(-0.4, abs=1e-6)
    assert all(abs(d.after_s) < 0.03 for d in data.synchronisation.delays)
    assert data.synchronisation.clocks[1].offset_s == pytest.approx(0.4, abs=0.03)


def test_examples_are_frames_of_the_test_part_with_their_own_boxes(data, folders):
    test = folders[0].read(catalogue.SPLIT).times_ns["test"]
    assert len(data.examples) == 3
    for example in data.examples:
        time_ns = round(example.time_s * 1e9)
        assert time_ns in test
        assert set(example.images) == {example.camera_id, example.other_id}
        truth, _, _ = boxes_at(crossing_traffic(), time_ns)
        np.testing.assert_allclose(example.labels, truth, atol=1e-9)
        error = np.linalg.norm(example.finetuned[:, None, :2] - truth[None, :, :2], axis=2).min(axis=1)
        assert len(error) and error.max() < 1.5
    assert len({example.camera_id for example in data.examples}) == 3


def test_doubtful_boxes_are_left_out(data):
    for instant in data.boxes:
        for boxes in (instant.boxes["baseline"], instant.boxes["fine-tuned"]):
            assert not (np.abs(boxes[:, :2]) < 1e-9).all(axis=1).any()


def test_rays_meet_their_vehicles(data):
    for instant in data.clusters:
        for cluster in np.unique(instant.clusters):
            points = instant.points[instant.clusters == cluster]
            assert np.linalg.norm(points - points.mean(axis=0), axis=1).max() < 4.0


def test_without_labels_nothing_is_labelled(folders, tmp_path):
    shutil.copytree(folders[0].root, tmp_path, dirs_exist_ok=True)
    made = StageFolders(tmp_path)
    made.give(catalogue.METRICS, Metrics.model_validate(metrics_json(labels=False)))
    found = assemble("Elm Street", made.reader, None, TITLES, examples=1)
    assert found.metrics.finetuned is None and found.examples[0].labels is None
    assert set(found.boxes[0].boxes) == {"baseline", "fine-tuned"}


def test_stage_writes_one_page(folders, tmp_path):
    shutil.copytree(folders[0].root, tmp_path, dirs_exist_ok=True)
    made = StageFolders(tmp_path)
    context = made.context("report", site_of(), assets={"labels": folders[1]})
    summary = report.run(context, ReportConfig(examples=2))
    page = made.read(catalogue.REPORT)
    assert summary == {"bytes": len(page.encode()), "examples": 2}
    assert "Find conflicts" in page and "5e5e5e5e5e5e5e5e" in page


def test_stretches_cover_everything_once():
    rig, tracks = corner_rig(4), crossing_traffic()
    instants = [annotated(rig, tracks, int(k * 2e8)) for k in range(11)]
    for count in (1, 3, 11, 20):
        parts = stretches(instants, count)
        assert [i.time_ns for part in parts for i in part] == [i.time_ns for i in instants]
        assert all(parts) and max(map(len, parts)) - min(map(len, parts)) <= 1
    assert stretches([], 3) == [] and busiest([], 3) == [] and choose_examples([], ("cam1",), 3) == []


def test_examples_take_cameras_in_turn_and_a_partner_that_shares_vehicles():
    rig, tracks = corner_rig(4), crossing_traffic()
    instants = [annotated(rig, tracks, int(k * 2e8)) for k in range(20)]
    chosen = choose_examples(instants, tuple(rig), 4)
    assert [choice.camera_id for choice in chosen] == list(rig)
    for choice in chosen:
        assert any({choice.camera_id, choice.other_id} <= set(v.views) for v in choice.instant.vehicles)


def test_frames_without_a_vehicle_are_no_examples():
    rig = corner_rig(2)
    empty = [annotated(rig, [], int(k * 2e8)) for k in range(6)]
    assert choose_examples(empty, tuple(rig), 3) == []
