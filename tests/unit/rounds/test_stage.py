"""The stage: boxes pass as they are where no round is needed, and else those of the round that is kept are written."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.builders import site_of
from tests.multiview import crossing
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.config import (
    AssociateConfig,
    DatasetConfig,
    DetectConfig,
    LiftConfig,
    PipelineConfig,
    RefineConfig,
    RoundsConfig,
)
from wibam_core.detection.instants import by_frame
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.formats.framestore import FrameStoreWriter
from wibam_core.rounds import rounds
from wibam_core.rounds.scenery import ToldApart
from wibam_core.scene import Boxes2D, FrameKey
from wibam_core.stages import rounds as stage
from wibam_core.stages.graph import InputDigests, plan


@pytest.fixture
def folders(tmp_path: Path) -> StageFolders:
    made, scene = StageFolders(tmp_path), crossing()
    instants, detected = by_frame(scene.unassociated[::4])
    few = {frame: Boxes2D(*(values[::2] for values in boxes)) for frame, boxes in detected.items()}
    made.give(catalogue.CALIBRATED_RIG, scene.rig)
    made.give(catalogue.RESIDUALS, CalibrationResiduals(cameras={}))
    made.give(catalogue.SEARCHED_INSTANTS, instants)
    made.give(catalogue.DETECTIONS, few)
    image = np.full((36, 64, 3), 100, np.uint8)
    with FrameStoreWriter(made.place(catalogue.FRAMES), 80) as writer:
        for one in instants:
            for camera, local_ns in one.local_times_ns.items():
                writer.add(camera, one.time_ns, local_ns, image)
        writer.close()
    times_ns = {camera: np.array([one.local_times_ns[camera] for one in instants]) for camera in scene.rig}
    made.give(catalogue.TIMESTAMPS, times_ns)
    return made


def run(folders: StageFolders, config: RoundsConfig) -> dict[str, object]:
    split = DatasetConfig(rate_hz=6.25, train_share=0.45, val_share=0.25, gap_s=0.1)
    others = (DetectConfig(), RefineConfig(min_vehicles=8), AssociateConfig(), split, LiftConfig())
    return stage.run(folders.context("rounds", site_of(crossing().rig), others=others), config)


def count(found: dict[FrameKey, Boxes2D]) -> int:
    return sum(len(boxes.boxes) for boxes in found.values())


def test_boxes_pass_where_rounds_are_switched_off(folders: StageFolders) -> None:
    assert run(folders, RoundsConfig(most=0, motion=False)) == {"rounds": 0, "kept": 0}
    given, passed = folders.read(catalogue.DETECTIONS), folders.read(catalogue.ROUND_DETECTIONS)
    assert given.keys() == passed.keys() and count(given) == count(passed) > 100
    assert folders.read(catalogue.ROUNDS).rounds == []
    assert not folders.reader.has(catalogue.DETECTOR_RIG)


def test_boxes_pass_where_the_detector_finds_nearly_everything(folders: StageFolders) -> None:
    _, everything = by_frame(crossing().unassociated[::4])
    folders.give(catalogue.DETECTIONS, everything)
    summary = run(folders, RoundsConfig())
    json.dumps(summary)
    assert (summary["rounds"], summary["kept"]) == (0, 0)
    (judged,) = folders.read(catalogue.ROUNDS).rounds
    assert (judged.agreement.found or 0) > 0.9
    assert folders.read(catalogue.DETECTOR_REFINEMENT).vehicles >= 8 and folders.reader.has(catalogue.DETECTOR_RIG)
    assert count(folders.read(catalogue.ROUND_DETECTIONS)) == count(everything)


def test_the_boxes_of_the_round_that_is_kept_are_written(
    folders: StageFolders, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, everything = by_frame(crossing().unassociated[::4])
    monkeypatch.setattr(rounds, "_taught", lambda world, state, number, progress: rounds._Taught(None, 7, 70))
    nothing = ToldApart.unasked(everything).on_scenery
    monkeypatch.setattr(rounds, "_found_again", lambda *given: rounds._FoundAgain(everything, everything, nothing))
    summary = run(folders, RoundsConfig(most=1, motion=False))
    assert (summary["rounds"], summary["kept"]) == (1, 1)
    json.dumps(summary)
    document = folders.read(catalogue.ROUNDS)
    assert [one.taught_vehicles for one in document.rounds] == [None, 7]
    assert document.rounds[1].agreement.an_instant > document.rounds[0].agreement.an_instant
    assert count(folders.read(catalogue.ROUND_DETECTIONS)) > 1.5 * count(folders.read(catalogue.DETECTIONS))


def test_what_a_round_goes_through_matters_only_where_there_is_one() -> None:
    def hashes(**options: dict[str, object]) -> dict[str, str]:
        inputs = InputDigests({"cam1": "a", "cam2": "b", "cam3": "c", "cam4": "d"}, {})
        return {one.name: one.hash for one in plan(site_of(), PipelineConfig.parse(options), inputs)}

    lift, never = {"lift": {"iterations": 20}}, {"rounds": {"most": 0, "motion": False}}
    assert hashes(**never)["rounds"] == hashes(**never, **lift)["rounds"]
    assert hashes()["rounds"] not in (hashes(**never)["rounds"], hashes(**lift)["rounds"])
    refine = {"refine": {"rotation_sd_deg": 1.0}}
    assert (
        hashes()["rounds"] != hashes(**refine)["rounds"]
        and hashes(**never)["rounds"] == hashes(**never, **refine)["rounds"]
    )
