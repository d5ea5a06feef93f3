"""The three stages one after the other, through the files that they exchange."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.multiview import crossing
from wibam_core.config import AssociateConfig, DatasetConfig, LiftConfig
from wibam_core.formats.annotations import read_annotations, write_annotations
from wibam_core.formats.rig import write_rig
from wibam_core.formats.vehicles3d import read_vehicles3d
from wibam_core.progress import silent
from wibam_core.site import MatrixCalibration, Site, SiteCamera
from wibam_core.stages import associate, dataset, lift
from wibam_core.stages.base import StageContext, Summary

EYE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
SITE = Site(
    name="test",
    cameras=(
        SiteCamera(
            id="cam1",
            width_px=640,
            height_px=360,
            calibration=MatrixCalibration(K=EYE, rvec=(0, 0, 0), tvec=(0, 0, 0)),
        ),
    ),
)


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Summary]]:
    root = tmp_path_factory.mktemp("stages")
    for name in ("calibrate", "detect", "associate", "dataset", "lift"):
        (root / name).mkdir()
    scene = crossing()
    write_rig(root / "calibrate" / "rig.json", scene.rig)
    write_annotations(root / "detect" / "detections.parquet", scene.unassociated)

    def context(name: str, *requires: str) -> StageContext:
        return StageContext(SITE, {}, {}, {r: root / r for r in requires}, root / name, root, silent)

    split = DatasetConfig(rate_hz=6.25, train_share=0.6, val_share=0.2, gap_s=0.3)
    summaries = {
        "associate": associate.run(context("associate", "calibrate", "detect"), AssociateConfig()),
        "dataset": dataset.run(context("dataset", "calibrate", "associate"), split),
        "lift": lift.run(context("lift", "calibrate", "associate", "dataset"), LiftConfig()),
    }
    return root, summaries


def test_labels_are_lifted_at_the_instants_of_the_split_alone(outputs: tuple[Path, dict[str, Summary]]) -> None:
    root, summaries = outputs
    split = json.loads((root / "dataset" / "split.json").read_text())
    lifts = read_vehicles3d(root / "lift" / "lifts.parquet")
    assert sorted(v.time_ns for v in lifts) == sorted(split["train"] + split["val"] + split["test"])
    assert sum(len(v) for v in lifts) == sum(summaries["lift"]["written"].values()) > 50


def test_no_vehicle_is_a_label_in_two_subsets(outputs: tuple[Path, dict[str, Summary]]) -> None:
    root, _ = outputs
    split = json.loads((root / "dataset" / "split.json").read_text())
    lifts = read_vehicles3d(root / "lift" / "lifts.parquet")
    ids = {
        name: {i for v in lifts if v.time_ns in set(split[name]) for i in v.ids.tolist()}
        for name in ("train", "val", "test")
    }
    assert ids["test"]
    assert not ids["train"] & ids["val"]
    assert not (ids["train"] | ids["val"]) & ids["test"]


def test_every_lift_belongs_to_a_vehicle_of_its_instant(outputs: tuple[Path, dict[str, Summary]]) -> None:
    root, _ = outputs
    instants = {i.time_ns: i for i in read_annotations(root / "associate" / "annotations.parquet")}
    for vehicles in read_vehicles3d(root / "lift" / "lifts.parquet"):
        tracks = [v.track_id for v in instants[vehicles.time_ns].vehicles]
        assert set(vehicles.ids.tolist()) <= set(tracks)
        assert len(set(vehicles.ids.tolist())) == len(vehicles)


def test_summaries_and_statistics_are_json(outputs: tuple[Path, dict[str, Summary]]) -> None:
    root, summaries = outputs
    for name, summary in summaries.items():
        json.dumps(summary, allow_nan=False)
        json.loads((root / name / "statistics.json").read_text())
    assert summaries["associate"]["vehicles"] > 100
    assert set(summaries["dataset"]["subsets"]) == {"train", "val", "test"}
