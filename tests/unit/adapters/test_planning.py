from __future__ import annotations

import pytest

from tests.builders import corner_rig, site_of
from wibam_core.adapters.planning import plan_stages
from wibam_core.errors import InputError, MissingCamera, UnknownOption
from wibam_core.jobs.records import Purpose, StoredFile
from wibam_core.stages.graph import STAGES

SITE = site_of(corner_rig(2))


def file(camera: str, sha256: str = "0", purpose: Purpose = Purpose.RECORDING) -> StoredFile:
    return StoredFile(f"file_{camera}", "site", purpose, camera, "x", "", 1, sha256 * 64, 0.0)


BOTH = [file("cam1"), file("cam2")]


def hashes(*files: StoredFile, **options: dict) -> dict[str, str]:
    return {stage.name: stage.hash for stage in plan_stages(SITE, options, files)}


def test_stages_come_after_what_they_require() -> None:
    seen: set[str] = set()
    for stage in plan_stages(SITE, {}, BOTH):
        assert seen.issuperset(stage.requires)
        seen.add(stage.name)
    assert seen == set(STAGES)


def test_a_hash_depends_on_recordings_and_options_alone() -> None:
    assert hashes(*BOTH) == hashes(*reversed(BOTH))
    assert hashes(*BOTH)["preflight"] != hashes(file("cam1"), file("cam2", "1"))["preflight"]
    changed = hashes(*BOTH, finetune={"steps": 7})
    assert changed["lift"] == hashes(*BOTH)["lift"]
    assert changed["finetune"] != hashes(*BOTH)["finetune"]
    assert changed["report"] != hashes(*BOTH)["report"]


def test_labels_change_the_evaluation_and_not_the_training() -> None:
    labelled = hashes(*BOTH, file("", purpose=Purpose.LABELS))
    assert labelled["finetune"] == hashes(*BOTH)["finetune"]
    assert labelled["evaluate"] != hashes(*BOTH)["evaluate"]


def test_recordings_of_cameras_that_the_site_does_not_have_count_for_nothing() -> None:
    assert hashes(*BOTH, file("cam9")) == hashes(*BOTH)


def test_refusals() -> None:
    with pytest.raises(MissingCamera, match="cameras cam1, cam2"):
        plan_stages(SITE, {}, [])
    with pytest.raises(MissingCamera, match="camera cam2"):
        plan_stages(SITE, {}, BOTH[:1])
    with pytest.raises(UnknownOption):
        plan_stages(SITE, {"x": 1}, BOTH)
    with pytest.raises(InputError, match="no detector"):
        plan_stages(SITE, {"detect": {"detector": "custom"}}, BOTH)
    with pytest.raises(InputError, match="no network"):
        plan_stages(SITE, {"finetune": {"network": "custom"}}, BOTH)
