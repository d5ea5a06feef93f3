"""The three stages one after the other, through the files that they exchange."""

from __future__ import annotations

import json

import pytest

from tests.multiview import crossing
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.config import AssociateConfig, DatasetConfig, LiftConfig
from wibam_core.documents.refinement import Refinement
from wibam_core.site import MatrixCalibration, Site, SiteCamera
from wibam_core.stages import associate, dataset, lift
from wibam_core.stages.base import Summary

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
def outputs(tmp_path_factory: pytest.TempPathFactory) -> tuple[StageFolders, dict[str, Summary]]:
    folders, scene = StageFolders(tmp_path_factory.mktemp("stages")), crossing()
    folders.give(catalogue.RIG, scene.rig)
    folders.give(catalogue.REFINEMENT, Refinement(method="none", taken=False, reason="it is exact"))
    folders.give_detected(scene.unassociated)
    split = DatasetConfig(rate_hz=6.25, train_share=0.6, val_share=0.2, gap_s=0.3)
    summaries = {
        "associate": associate.run(folders.context("associate", SITE), AssociateConfig()),
        "dataset": dataset.run(folders.context("dataset", SITE), split),
        "lift": lift.run(folders.context("lift", SITE), LiftConfig()),
    }
    return folders, summaries


def test_fits_are_at_the_instants_of_the_split_alone(outputs: tuple[StageFolders, dict[str, Summary]]) -> None:
    folders, summaries = outputs
    times = folders.read(catalogue.SPLIT).times_ns
    fits = folders.read(catalogue.FITS)
    assert sorted(v.time_ns for v in fits) == sorted(times["train"] + times["val"] + times["test"])
    assert sum(len(v) for v in fits) == sum(summaries["lift"]["written"].values()) > 50


def test_no_vehicle_teaches_in_two_subsets(outputs: tuple[StageFolders, dict[str, Summary]]) -> None:
    folders, _ = outputs
    times = folders.read(catalogue.SPLIT).times_ns
    fits = folders.read(catalogue.FITS)
    ids = {
        name: {i for v in fits if v.time_ns in set(times[name]) for i in v.ids.tolist()}
        for name in ("train", "val", "test")
    }
    assert ids["test"]
    assert not ids["train"] & ids["val"]
    assert not (ids["train"] | ids["val"]) & ids["test"]


def test_every_fit_belongs_to_a_vehicle_of_its_instant(outputs: tuple[StageFolders, dict[str, Summary]]) -> None:
    folders, _ = outputs
    instants = {i.time_ns: i for i in folders.read(catalogue.ANNOTATIONS)}
    for vehicles in folders.read(catalogue.FITS):
        tracks = [v.track_id for v in instants[vehicles.time_ns].vehicles]
        assert set(vehicles.ids.tolist()) <= set(tracks)
        assert len(set(vehicles.ids.tolist())) == len(vehicles)


def test_summaries_are_json_and_say_what_the_statistics_do(
    outputs: tuple[StageFolders, dict[str, Summary]],
) -> None:
    folders, summaries = outputs
    for summary in summaries.values():
        json.dumps(summary, allow_nan=False)
    assert summaries["associate"] == folders.read(catalogue.ASSOCIATION_STATISTICS).model_dump()
    assert summaries["lift"]["kept"] == folders.read(catalogue.LIFT_STATISTICS).kept
    assert summaries["associate"]["vehicles"] > 100
    assert set(summaries["dataset"]["subsets"]) == {"train", "val", "test"}
