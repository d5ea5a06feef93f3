"""Cameras refined by a few seconds of traffic whose geometry is known, with bodies that are not the catalogue's."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.builders import site_of
from tests.multiview import crossing, wide_crossing
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.config import LiftConfig, RefineConfig
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.documents.refinement import Refinement
from wibam_core.documents.rounds import Rounds
from wibam_core.geometry.se3 import SE3
from wibam_core.lifting.lift import lift
from wibam_core.refinement.cautions import cautions_of
from wibam_core.refinement.refine import Refined, refine
from wibam_core.scene import CameraRig
from wibam_core.stages import refine as stage

NOTHING_KNOWN = CalibrationResiduals(cameras={})
FEW = RefineConfig(method="traffic", min_vehicles=8)
TURNED_DEG = 0.7


def turned(rig: CameraRig) -> CameraRig:
    """Every camera turned by 0.7° about an axis of its own."""
    rng, cameras = np.random.default_rng(1), {}
    for name, camera in rig.items():
        axis = rng.normal(size=3)
        rotation = cv2.Rodrigues(np.radians(TURNED_DEG) * axis / np.linalg.norm(axis))[0]
        pose = camera.T_world_cam
        cameras[name] = replace(camera, T_world_cam=SE3(pose.rotation @ rotation, pose.translation))
    return CameraRig(cameras)


def off_deg(rig: CameraRig, truth: CameraRig) -> list[float]:
    """By how much each camera is turned against the truth."""
    between = [rig[name].T_world_cam.rotation.T @ truth[name].T_world_cam.rotation for name in truth]
    return [float(np.degrees(np.linalg.norm(cv2.Rodrigues(rotation)[0]))) for rotation in between]


@pytest.fixture(scope="module")
def refined() -> Refined:
    scene = crossing()
    return refine(scene.unassociated, turned(scene.rig), NOTHING_KNOWN, FEW)


def test_turned_cameras_are_turned_back(refined: Refined) -> None:
    truth = crossing().rig
    assert refined.document.taken
    assert max(off_deg(refined.rig, truth)) < 0.35 * TURNED_DEG
    apart_m = np.array([refined.rig[name].centre_m - truth[name].centre_m for name in truth])
    # traffic does not tell where all of them are together
    assert np.linalg.norm(apart_m - apart_m.mean(axis=0), axis=1).max() < 0.2


def test_what_was_changed_is_said(refined: Refined) -> None:
    document = refined.document
    assert document.held_out is not None and document.held_out.after_px < 0.5 * document.held_out.before_px
    assert all(abs(camera.turned_deg - TURNED_DEG) < 0.35 for camera in document.cameras.values())
    (caution,) = (caution for caution in cautions_of(document) if caution.code == "calibration_refined")
    assert "refine.method=none" in caution.hint
    assert set(caution.details) == set(document.cameras)


def test_the_stated_standard_deviations_hold_the_errors(refined: Refined) -> None:
    truth = crossing().rig
    for name, camera in refined.rig.items():
        error = cv2.Rodrigues(camera.T_world_cam.rotation.T @ truth[name].T_world_cam.rotation)[0].ravel()
        sd = np.radians(refined.document.cameras[name].rotation_sd_deg)
        assert (np.abs(error) < 3 * sd).all()
        assert (sd < np.radians(RefineConfig(method="traffic").rotation_sd_deg)).all()


def test_cameras_that_are_right_stay_to_the_bit_and_an_error_they_may_have_is_stated() -> None:
    scene = crossing()
    found = refine(scene.unassociated, scene.rig, NOTHING_KNOWN, FEW)
    assert not found.document.taken and found.rig is scene.rig and not cautions_of(found.document)
    assert found.document.held_out is not None and found.document.held_out.gain < 0.25
    for matrix in found.document.covariances.values():
        assert np.linalg.eigvalsh(np.array(matrix)).min() > 0


def test_cameras_with_wide_lenses_are_turned_back_by_what_their_views_show() -> None:
    scene = wide_crossing()
    mounted = turned(CameraRig(scene.rig.mounted))
    found = refine(scene.unassociated, CameraRig(mounted.mounted, scene.rig.views), NOTHING_KNOWN, FEW)
    assert found.document.taken and set(found.document.cameras) == set(scene.rig.mounted)
    assert set(found.document.covariances) == set(scene.rig)
    assert max(off_deg(found.rig, scene.rig)) < 0.5 * TURNED_DEG
    focal = refine(scene.unassociated[:2], scene.rig, NOTHING_KNOWN, FEW.model_copy(update={"intrinsics": "focal"}))
    assert "intrinsics" in focal.document.reason


def test_a_road_that_lies_lower_than_it_was_taken_to_is_found() -> None:
    """0.3 m lower: cameras are as they were measured, but for their heights above it."""
    scene, cameras = crossing(), {}
    for name, camera in scene.rig.items():
        pose = camera.T_world_cam
        cameras[name] = replace(camera, T_world_cam=SE3(pose.rotation, pose.translation - [0.0, 0.0, 0.3]))
    found = refine(scene.unassociated, CameraRig(cameras), NOTHING_KNOWN, FEW)
    assert found.document.taken and found.document.ground is not None
    assert found.document.ground.height_m == pytest.approx(-0.3, abs=0.1)
    heights_m = [found.rig[name].centre_m[2] - scene.rig[name].centre_m[2] for name in scene.rig]
    assert np.abs(heights_m).max() < 0.08
    assert max(off_deg(found.rig, scene.rig)) < 0.25


def test_vehicles_lie_on_average_where_the_calibration_had_them(refined: Refined) -> None:
    """Traffic does not tell where all cameras are together."""
    scene = crossing()
    of_several = [
        replace(one, vehicles=tuple(vehicle for vehicle in one.vehicles if len(vehicle.views) > 2))
        for one in scene.instants[::3]
    ]
    fits = [lift(of_several, rig, LiftConfig()).vehicles for rig in (turned(scene.rig), refined.rig)]
    moved = []
    for before, after in zip(*fits, strict=True):
        _, rows, others = np.intersect1d(before.ids, after.ids, return_indices=True)
        moved.append(after.boxes[others, :2] - before.boxes[rows, :2])
    apart_m = np.concatenate(moved)
    assert len(apart_m) > 50 and np.median(np.linalg.norm(apart_m, axis=1)) > 0.15
    assert np.abs(np.median(apart_m, axis=0)).max() < 0.08


@pytest.mark.parametrize(
    ("options", "words"),
    [({"min_vehicles": 500}, "fewer than refine.min_vehicles"), ({}, "two cameras")],
)
def test_where_nothing_can_be_said_cameras_stay_and_it_is_said_why(options: dict[str, object], words: str) -> None:
    scene = crossing()
    instants = scene.unassociated[:30]
    if not options:  # each camera sees vehicles at instants of its own
        instants = [
            replace(one, detections={name: one.detections[name] for name in [tuple(scene.rig)[k % 4]]})
            for k, one in enumerate(instants)
        ]
    found = refine(instants, scene.rig, NOTHING_KNOWN, RefineConfig.model_validate({"method": "traffic", **options}))
    assert found.rig is scene.rig and not found.document.taken
    assert words in found.document.reason


def test_stage_passes_the_rig_on_where_it_is_switched_off(tmp_path: Path) -> None:
    folders, scene = StageFolders(tmp_path), crossing()
    folders.give(catalogue.CALIBRATED_RIG, scene.rig)
    folders.give(catalogue.RESIDUALS, NOTHING_KNOWN)
    folders.give_detected(scene.unassociated[:2])
    folders.give(catalogue.ROUNDS, Rounds(rounds=[], kept=0, reason="rounds are switched off"))
    summary = stage.run(folders.context("refine", site_of()), RefineConfig(method="none"))
    assert summary["taken"] is False
    written = folders.read(catalogue.RIG)
    assert off_deg(written, scene.rig) == [0.0] * len(scene.rig)
    assert folders.read(catalogue.REFINEMENT).method == "none"
    assert folders.read(catalogue.REFINEMENT).reason == "refine.method is none"


@pytest.mark.parametrize(("kept", "by_all"), [(1, True), (0, False)])
def test_boxes_that_rounds_found_refine_the_cameras_again(
    tmp_path: Path, refined: Refined, kept: int, by_all: bool
) -> None:
    """Rounds refined them by fewer boxes, and found the calibration right."""
    folders, scene = StageFolders(tmp_path), crossing()
    by_few = Refinement(method="traffic", taken=False, reason="few boxes say so")
    folders.give(catalogue.CALIBRATED_RIG, turned(scene.rig))
    folders.give(catalogue.RESIDUALS, NOTHING_KNOWN)
    folders.give_detected(scene.unassociated)
    folders.give(catalogue.DETECTOR_RIG, turned(scene.rig))
    folders.give(catalogue.DETECTOR_REFINEMENT, by_few)
    folders.give(catalogue.ROUNDS, Rounds(rounds=[], kept=kept, reason="that is enough"))
    summary = stage.run(folders.context("refine", site_of()), FEW)
    written, document = folders.read(catalogue.RIG), folders.read(catalogue.REFINEMENT)
    assert summary["taken"] == document.taken == by_all
    assert (max(off_deg(written, refined.rig)) < 0.05) == by_all
    assert (document == by_few) == (not by_all)


def test_the_stage_loads_no_torch_where_it_is_switched_off() -> None:
    program = "import sys, wibam_core.stages.refine; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], check=True)
